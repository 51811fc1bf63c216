"""What borders of projected pictures add to derivatives is that of finite differences, and carries the light across."""

from __future__ import annotations

import pytest
import torch

import torch_radbp as rb
from tests.deep import deep_but
from tests.derivatives.in_expectation import Effort, Estimate, Row, assert_agrees
from tests.scenes import diffuse, load, look_at, overhead
from tests.scenes.projected import PICTURES, PROJECTOR, TEXELS
from torch_radbp.boundary.terms import pictures
from torch_radbp.io.values.transform import scale
from torch_radbp.plugin.jump_lines import JumpLines

pytestmark = pytest.mark.filterwarnings("ignore::torch_radbp.SilhouetteWarning")

BATCHES = 8

# The bias that a batch of so many samples shows.
SHOWN = {(0.1, 256): ("lamp, texels", "sensor, texels", "lamp, smooth", "sensor, smooth"),
         (0.4, 512): tuple(name for name in PICTURES if name.split(",")[0] == "floor" or "spot" in name or "two" in name)}
ROWS = [Row(name, bias, spp) for (bias, spp), names in SHOWN.items() for name in names]
QUICK = ("lamp, texels",)


@pytest.mark.parametrize("row", deep_but([row for row in ROWS if row.name in QUICK], ROWS), ids=str)
def test_derivatives_are_those_of_finite_differences(row):
    """And if they were wrong by the stated bias, that would be noticed."""
    measured = Estimate(PICTURES[row.name], Effort(row.spp, BATCHES))
    measured.add_round()
    assert_agrees(measured, row, ("agrees", "too noisy"))


def test_lines_are_cut_off_at_the_borders_of_the_picture():
    """An oblique line, of which some lie beside the picture; and lines along the sides, which are the border's own."""
    start, end = pictures.in_picture(JumpLines(2.0, 1.0, 0.0), False, torch.device("cpu"))
    ends = torch.stack([torch.stack([start.x, start.y], 1), torch.stack([end.x, end.y], 1)], 1)  # 2 u + v = 1, 2
    assert torch.allclose(ends.sort(1).values, torch.tensor([[[0, 0], [0.5, 1]], [[0.5, 0], [1, 1]]]).double())
    for whole, count in ((False, 2), (True, 4)):
        start, end = pictures.in_picture(JumpLines(3.0, 0.0, 0.0), whole, torch.device("cpu"))
        assert len(start.x) == count and torch.allclose(start.x, end.x)
        assert torch.equal(torch.minimum(start.y, end.y), torch.zeros(count).double())


def test_a_picture_that_moves_over_a_plane_takes_its_light_with_it():
    """Seen from straight above: the first moment of the image grows by its sum. Without the borders it would shrink."""
    view = overhead(48, half=1.5)
    floor = {"type": "rectangle", "to_world": scale((9, 9, 1)), "bsdf": diffuse(0.6, 0.6, 0.6)}
    lamp = PROJECTOR | {"to_world": look_at((0.1, 0.05, 2), (0.1, 0.05, 0), (0.3, 1, 0)), "irradiance": TEXELS}
    scene = load(torch.float64, sensor=view, floor=floor, lamp=lamp)
    tangent = torch.zeros(4, 4, dtype=torch.float64)
    tangent[0, 3] = 1.0
    image = rb.render(scene, spp=256, seed=1, max_depth=2)[0].detach()
    size = 3.0 / 48
    x = (torch.arange(48, dtype=torch.float64) + 0.5) * size - 1.5
    # Which way x runs on the film is seen by the picture itself, which lies at 0.1.
    x = x if float((image * x).sum() / image.sum()) > 0 else -x
    found, without = ((rb.jvp(scene, {"lamp.to_world": tangent}, spp=256, seed=2, max_depth=2, terms=chosen)[0]
                       * x).sum((1, 2)) for chosen in (("interior", "primary", "shadow"), ("interior", "primary")))
    expected = image.sum((1, 2))
    assert (expected > 1).all()
    assert torch.allclose(found, expected, rtol=0.02)
    assert not torch.allclose(without, expected, rtol=0.5)
