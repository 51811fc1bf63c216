"""Where bodies touch, derivatives lie between the one-sided ones of differences, however pixels are weighted."""

from __future__ import annotations

from typing import NamedTuple

import pytest
import torch
from torch import Tensor

import torch_radbp as rb
from tests.deep import deep_but
from tests.scenes.contacts import BODIES, LAMPS, MOTIONS, SIZE, SUBJECT, Arrangement

pytestmark = pytest.mark.filterwarnings("ignore::torch_radbp.SilhouetteWarning", "ignore::torch_radbp.JumpWarning")

SPP, BATCHES = 256, 4  # of derivatives: 1,024 samples in all
SPP_OF_DIFFERENCES, PAIRS = 4096, 4
STEP = 0.003  # with twice the step differences of these scenes bend by 1 to 3 %


class Sides(NamedTuple):
    """Sums over a derivative image with K weights, (K,) each."""

    backward: Tensor  # the difference by a step back
    forward: Tensor
    found: Tensor
    noise: Tensor  # the standard error of all three together

    def between(self) -> Tensor:
        """(K,) bool: what is found lies between both, within 5 % of the larger one and 4 standard errors."""
        low, high = torch.minimum(self.backward, self.forward), torch.maximum(self.backward, self.forward)
        slack = 0.05 * torch.maximum(low.abs(), high.abs()) + 4 * self.noise
        return (self.found >= low - slack) & (self.found <= high + slack)


def smooth_weights() -> Tensor:
    """(K, H, W) float64."""
    places = (torch.arange(SIZE, dtype=torch.float64) + 0.5) / SIZE * 2 - 1
    y, x = torch.meshgrid(places, places, indexing="ij")
    return torch.stack([torch.ones_like(x), torch.cos(2 * x + y), torch.sin(3 * x - 2 * y), x, y])


def sides_of(arrangement: Arrangement) -> Sides:
    scene, weights = arrangement.build(), smooth_weights()
    names = dict(scene.named_parameters())
    name = next(name for name in (f"{SUBJECT}.vertex_positions", f"{SUBJECT}.to_world") if name in names)
    parameter = scene.get_parameter(name)
    home, tangent = parameter.detach().clone(), arrangement.tangent(parameter.detach())

    def sums(image: Tensor) -> Tensor:
        return (weights * image.double().sum((0, 1))).sum((1, 2))

    def image(side: int, seed: int) -> Tensor:
        parameter.data = home + side * STEP * tangent
        return sums(rb.render(scene, spp=SPP_OF_DIFFERENCES, seed=seed, max_depth=arrangement.max_depth).detach())

    differences = []
    for seed in range(100, 100 + PAIRS):
        back, here, ahead = (image(side, seed) for side in (-1, 0, 1))
        differences.append(torch.stack([here - back, ahead - here]) / STEP)
    parameter.data = home
    found = torch.stack([sums(rb.jvp(scene, {name: tangent}, spp=SPP, seed=seed, max_depth=arrangement.max_depth))
                         for seed in range(BATCHES)])
    differences = torch.stack(differences)
    noise = torch.sqrt(differences.var(0).sum(0) / PAIRS + found.var(0) / BATCHES)
    return Sides(*differences.mean(0), found.mean(0), noise)


QUICK = [Arrangement("cube on a floor", "point", "up")]


def seen_to_change(body: str, lamp: str, motion: str) -> bool:
    """False if nothing is lit that the camera sees, or a floor moves within its plane."""
    return (body, lamp) != ("cube against a wall", "point behind") and (
        body != "cube under a floor that moves" or motion in ("up", "up and aside", "tilting"))


WAYS = [(lamp, motion) for lamp in LAMPS for motion in MOTIONS]
ROWS = [*QUICK, Arrangement("wall on a floor", "point", "tilting"),
        *(Arrangement(body, *way) for number, body in enumerate(BODIES) for place, way in enumerate(WAYS)
          if (place + 5 * number) % 7 == 0 and seen_to_change(body, *way))]


@pytest.mark.parametrize("arrangement", deep_but(QUICK, dict.fromkeys(ROWS)), ids=str)
def test_derivatives_lie_between_the_one_sided_ones(arrangement):
    sides = sides_of(arrangement)
    assert all(part.isfinite().all() for part in sides) and sides.forward.abs().max() > 1
    assert sides.between().all(), sides


def test_lifting_a_cube_has_two_derivatives_whose_mean_is_found():
    """A body seen from above, lit from the side that is seen: if it rises, what comes into view is dark."""
    sides = sides_of(Arrangement("pyramid on a floor", "point", "up"))
    apart = (sides.forward - sides.backward).abs()
    assert apart[0] > 20 * sides.noise[0]
    assert abs(sides.found[0] - 0.5 * (sides.forward + sides.backward)[0]) < 4 * sides.noise[0] + 0.05 * apart[0]
