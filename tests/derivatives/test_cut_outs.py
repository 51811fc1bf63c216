"""The derivative of light that comes through holes and panes is that of meshes with holes, and of finite differences."""

from __future__ import annotations

import math

import pytest
import torch

import torch_radbp as rb
from tests.deep import deep, deep_but
from tests.derivatives.in_expectation import Effort, Estimate, Row, assert_agrees
from tests.scenes.cut_outs import CUT_OUTS, LAMP, PUSHED, TEXELS, masked, seen, sheet, sheet_with_holes
from torch_radbp.boundary.terms import seen_through

pytestmark = pytest.mark.filterwarnings("ignore::torch_radbp.SilhouetteWarning")

BATCHES = 8

# The bias that a batch of so many samples shows.
SHOWN = {
    (0.2, 1024): ("sheet, texels", "instance", "sheet, four bounces"),
    (0.4, 2048): ("lamp, texels", "sheet, squares", "lamp, squares", "lamp behind a pane", "vertices of a sheet",
                  "ball before a sky", "lamp behind two sheets"),
    (0.6, 2048): ("floor, texels", "sensor, texels"),
}
ROWS = [Row(name, bias, spp) for (bias, spp), names in SHOWN.items() for name in names]


def test_every_scene_is_examined():
    assert sorted(row.name for row in ROWS) == sorted(CUT_OUTS)


@pytest.mark.parametrize("row", deep_but([], ROWS), ids=str)
def test_derivatives_are_those_of_finite_differences(row):
    """And if they were wrong by the stated bias, that would be noticed."""
    measured = Estimate(CUT_OUTS[row.name], Effort(row.spp, BATCHES))
    measured.add_round()
    assert_agrees(measured, row, ("agrees", "too noisy"))


def sums(build, name: str, weights: torch.Tensor, spp: int, max_depth: int) -> torch.Tensor:
    """Eight independent derivatives of a weighted sum of pixels."""
    scene = build()
    tangent = PUSHED[name](scene.get_parameter(f"{name}.to_world").detach())
    return torch.stack([(rb.jvp(scene, {f"{name}.to_world": tangent}, seed=seed, spp=spp, max_depth=max_depth)
                         * weights).sum() for seed in range(8)])


def assert_alike(found: torch.Tensor, expected: torch.Tensor, most: float) -> None:
    """Means of independent numbers agree, and standard errors are at most such a share."""
    error = math.hypot(*(float(own.std()) / math.sqrt(len(own)) for own in (found, expected)))
    reference = abs(float(expected.mean()))
    assert reference > 0 and error < most * reference
    assert abs(float(found.mean() - expected.mean())) <= 3.5 * error


# Under a moving lamp the mesh has four times the noise of the cut-out: its interior and its shadows nearly cancel out.
@pytest.mark.parametrize("name, spp, of_mesh, most", [
    ("sheet", 192, 192, 0.12), deep("lamp", 2048, 8192, 0.06), deep("floor", 512, 512, 0.03),
    deep("sensor", 1024, 1024, 0.03)])
def test_a_cut_out_has_the_derivatives_of_a_mesh_with_such_holes(name, spp, of_mesh, most):
    """Whose light next-event estimation finds, and whose edges are counted as those of any mesh."""
    weights = 1.0 + torch.linspace(0, 1, 16, dtype=torch.float64)
    cut_out = sums(seen(LAMP, sheet=sheet(masked(TEXELS))), name, weights, spp, 3)
    mesh = sums(seen(LAMP, sheet=sheet_with_holes()), name, weights, of_mesh, 2)
    assert_alike(cut_out, mesh, most)


def test_what_is_not_there_hides_nothing_and_its_motion_changes_nothing():
    through, plain = seen(LAMP, sheet=sheet({"type": "null"})), seen(LAMP)
    weights = torch.ones(16, dtype=torch.float64)
    assert_alike(sums(through, "lamp", weights, 64, 3), sums(plain, "lamp", weights, 16, 2), 0.1)
    found = sums(through, "sheet", weights, 64, 3)
    assert abs(float(found.mean())) <= 3.5 * float(found.std()) / math.sqrt(len(found))


def test_edges_are_looked_for_through_surfaces_only_where_these_let_light_pass(monkeypatch):
    """And where paths are so long that light may come through."""
    looked = []
    monkeypatch.setattr(seen_through.SeenThrough, "samples", lambda *arguments: looked.append(arguments))
    for bsdf, depth in (({"type": "diffuse"}, 3), (masked(TEXELS), 2), (masked(TEXELS), 3)):
        scene = seen(LAMP, sheet=sheet(bsdf))()
        tangent = PUSHED["lamp"](scene.get_parameter("lamp.to_world").detach())
        rb.jvp(scene, {"lamp.to_world": tangent}, seed=0, spp=1, max_depth=depth)
        assert len(looked) == (depth == 3 and bsdf["type"] == "mask")
