"""Samples of shadows go where they lower the noise, and places near eyes are spread by how much light turns there."""

import math
from typing import NamedTuple

import pytest
import torch

import torch_radbp as rb
from tests.scenes.shadows import SHADOWS
from torch_radbp.boundary.curve.places import NEIGHBOURS
from torch_radbp.boundary.eye.seen_edges import evenly_seen
from torch_radbp.boundary.eye.viewpoints import Viewpoints
from torch_radbp.boundary.eye.ways_down import weights_apart
from torch_radbp.boundary.terms import hidden_light, split
from torch_radbp.boundary.terms.cuts import Cuts, CutsOfView, with_used_viewpoints
from torch_radbp.tensors.vec import Vec3

NOISE = 3.8e-7  # of another integral, beside which a plate's cuts are just worth a look of their own, or just not

pytestmark = pytest.mark.filterwarnings("ignore::torch_radbp.SilhouetteWarning")


class Samples(NamedTuple):
    amounts: torch.Tensor

    def independent(self) -> torch.Tensor:
        return self.amounts


def samples(count: int, size: float) -> Samples:
    return Samples(torch.full((3, count), size / math.sqrt(3.0)))


def test_the_variance_is_the_sum_of_squares():
    assert split.variance(samples(50, 0.1)) == pytest.approx(50 * 0.1**2)
    assert split.variance(None) == 0.0


def test_samples_of_one_path_are_no_independent_ones():
    cuts = Cuts(torch.tensor([7, 7, 2, 7]), None, None, None, None)
    strength = torch.tensor([[1.0, 2.0, 10.0, 0.5]], dtype=torch.float64).repeat(3, 1)
    found = CutsOfView(None, cuts, None, strength, torch.tensor([2.0, 1.0, 0.1, 2.0], dtype=torch.float64))
    assert found.independent().tolist() == [[1.0, 5.0]] * 3
    assert split.variance(found) == pytest.approx(3 * 26.0)


def test_viewpoints_without_cuts_are_left_out():
    points = torch.tensor([10.0, 20.0, 30.0, 40.0])
    cuts = Cuts(torch.tensor([3, 1, 3], dtype=torch.int32), None, None, None, None)
    found = with_used_viewpoints(CutsOfView(points, cuts, None, None, None))
    assert found.points.tolist() == [20.0, 40.0]
    assert found.cuts.viewpoint.tolist() == [1, 0, 1] and found.cuts.viewpoint.dtype == torch.int32


@pytest.mark.parametrize("quiet", [1.0, 0.5, 0.2, 0.01])
def test_samples_are_as_the_root_of_the_variance_over_their_cost_but_for_the_least(quiet):
    tried = samples(64, 0.1)
    first = split.TRIED * split.variance(tried) / (split.COST * quiet**2)
    assert split.effort(first, tried) == pytest.approx(max(quiet, split.LEAST))


def test_where_nothing_is_found_the_least_is_taken():
    assert split.effort(1e9, None) == split.LEAST and split.effort(0.0, samples(64, 0.1)) == 1.0


def test_what_is_not_worth_it_gets_fewer_samples(monkeypatch):
    """The shadow of a lamp is far stronger than that of the light that a floor sends back to what stands on it."""
    amounts, cuts = [], hidden_light.cuts_of_view

    def noted(call, number, casting, amount, *, counted):
        amounts.append(amount)
        return cuts(call, number, casting, amount, counted=counted)

    monkeypatch.setattr(hidden_light, "cuts_of_view", noted)
    moving = SHADOWS["cube, rectangle"]
    monkeypatch.setattr(split, "WORTH", 1)
    scene = moving.build()
    rb.jvp(scene, {moving.name: moving.tangent(scene)}, spp=128, seed=0, max_depth=3, terms=("shadow",))
    assert amounts[0] == split.Amount(split.LEAST, split.TRIED)
    assert sum(amount.counted for amount in amounts) < 1.0


@pytest.mark.parametrize("first, amounts", [(1e9, [(0.25, 0.0625, 0.0)]), (1e-6, [(0.25, 0.0625, 0.0), (0.75, 0.0, 0.25)])])
def test_others_are_found_only_if_they_are_worth_it(first, amounts):
    asked = []

    def found(amount):
        asked.append(tuple(amount))
        return cuts_of([True, False, False] if amount.tried else [False] * 3, 1.0)

    kept = split.as_worth(first, found)
    assert asked == amounts
    assert kept.points.tried is None and len(kept.points.depth) == len(kept.strength[0]) == 2 + 3 * (len(asked) - 1)
    # Of two samples of the same, 2 and 3 cuts of size 1, by the numbers of paths behind them.
    assert float(kept.strength[0].sum()) == pytest.approx(2.0 if len(asked) == 1 else 0.25 * 2.0 + 0.75 * 3.0)


def cuts_of(tried: list[bool], size: float) -> CutsOfView:
    """A cut for each of some paths."""
    count = len(tried)
    number, flags = torch.arange(count, dtype=torch.int32), torch.tensor(tried) if any(tried) else None
    points = Viewpoints(*[None] * 3, number.long(), *[None] * 6, flags)
    return CutsOfView(points, Cuts(number, number, *[None] * 3), None,
                                   torch.full((3, count), size, dtype=torch.float64), torch.ones(count, dtype=torch.float64))


def test_what_is_tried_has_places_of_its_own():
    generator = torch.Generator().manual_seed(2)
    weight = torch.rand(5000, generator=generator, dtype=torch.float64) * (torch.arange(5000) % 3 > 0)
    tried = torch.arange(5000) < 900
    scaled, count = weights_apart(weight, tried, 2000, 0.2)
    assert float(scaled[tried].sum()) == pytest.approx(448.0) and float(scaled[~tried].sum()) == pytest.approx(1600.0)
    assert count == 2048 and 448 % NEIGHBOURS == 0
    for own in (tried, ~tried):
        share = scaled[own] / weight[own]
        assert torch.allclose(share[weight[own] > 0], share[weight[own] > 0][0])
    assert weights_apart(weight * ~tried, tried, 2000, 0.2)[1] == 1600
    assert weights_apart(weight * 0, tried, 2000, 0.2)[1] == 0
    alone = torch.arange(5000) == 1000
    assert weights_apart(weight * alone, tried, 1, 0.2)[1] == 1  # what is found is not lost


def test_the_derivative_is_the_same_with_those_that_tell_the_noise(monkeypatch):
    """A plate over a floor under an even sky, in sums over the film, where now few cuts are taken and now many."""
    moving, found, worth, cuts = SHADOWS["plate, constant"], {}, [], hidden_light.cuts_of_view
    effort = split.effort

    def noted(first, tried):
        worth.append(effort(first, tried))
        return worth[-1]

    def as_worth(call, number, casting, amount, *, counted):
        return split.as_worth(NOISE, lambda amount: cuts(call, number, casting, amount, counted=counted))

    monkeypatch.setattr(split, "effort", noted)
    for name, taken in (("all", cuts), ("split", as_worth)):
        monkeypatch.setattr(hidden_light, "cuts_of_view", taken)
        scene = moving.build()
        found[name] = torch.stack([rb.jvp(scene, {moving.name: moving.tangent(scene)}, spp=256, seed=seed, terms=("shadow",),
                                          max_depth=moving.max_depth)[0] for seed in range(8)]).double()
    assert min(worth) < split.LEAST + split.TRIED < max(worth)
    weights = found["all"].mean(0).sign()
    sums = {name: (images * weights).sum((1, 2, 3)) for name, images in found.items()}
    noise = sum(float(own.var()) / len(own) for own in sums.values())**0.5
    assert noise < 0.05 * float(sums["all"].mean())
    assert abs(float(sums["all"].mean() - sums["split"].mean())) < 4.0 * noise


def test_nothing_is_split_beside_sharp_shadows(monkeypatch):
    monkeypatch.setattr(split, "effort", lambda *_: pytest.fail("it was split"))
    moving = SHADOWS["camera before a wall, spot"]
    monkeypatch.setattr(split, "WORTH", 1)
    scene = moving.build()
    image = rb.jvp(scene, {moving.name: moving.tangent(scene)}, spp=8, seed=0, max_depth=moving.max_depth, terms=("shadow",))
    assert image.isfinite().all() and image.abs().max() > 0


def test_places_on_a_line_are_seen_evenly():
    a, b = Vec3(*torch.tensor([[1.0, 0.02, 0.0]], dtype=torch.float64).T), Vec3(*torch.tensor([[-0.4, 0.0, 0.3]],
                                                                                          dtype=torch.float64).T)
    turn = (torch.arange(4096, dtype=torch.float64) + 0.5) / 4096
    along, density = evenly_seen(a, b, turn)
    p = torch.stack(tuple(a + (b - a) * along), 1)
    to = p / p.norm(dim=1, keepdim=True)
    steps = (to[1:] * to[:-1]).sum(1).clamp(-1, 1).acos()
    assert steps.max() < 1.001 * steps.min() and (along.diff() > 0).all()
    assert float((1.0 / density).mean()) == pytest.approx(1.0, rel=1e-3)
    # The density over the way is the turn per way.
    assert torch.allclose(density[1:-1], 2.0 / 4096 / (along[2:] - along[:-2]), rtol=1e-2)


def test_lines_that_are_seen_end_on_have_places_everywhere():
    a, b = (Vec3(*(torch.full((3,), value, dtype=torch.float64) for value in end)) for end in ((1, 0, 0), (2, 0, 0)))
    along, density = evenly_seen(a, b, torch.tensor([0.1, 0.5, 0.9], dtype=torch.float64))
    assert along.tolist() == [0.1, 0.5, 0.9] and density.tolist() == [1.0] * 3
