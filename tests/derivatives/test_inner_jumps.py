"""What jumps inside of surfaces, textures and surfaces that cross, adds to derivatives is that of finite differences."""

from __future__ import annotations

import pytest

from tests.deep import deep_but
from tests.derivatives.in_expectation import Effort, Estimate, Row, assert_agrees
from tests.scenes.inner_jumps import INNER_JUMPS

pytestmark = pytest.mark.filterwarnings("ignore::torch_radbp.SilhouetteWarning")

BATCHES = 8

# The bias that a batch of so many samples shows.
SHOWN = {
    (0.05, 512): ("checkerboard", "texels, repeat", "texels, mirror", "a lamp in squares", "ball in a floor, floor",
                  "walls that cross", "texels slide", "sheets of a mesh, camera", "ribbon through itself"),
    (0.05, 1024): ("texels, clamp", "roughness in squares", "squares slide"),
    (0.05, 2048): ("checkerboard, camera", "instance in a floor", "ball in a floor, the wall that sees it"),
    (0.1, 512): ("sheets of a mesh", "checkerboard, field of view", "ball in a floor, camera"),
    (0.1, 1024): ("cut out", "holes slide"),
    (0.2, 512): ("ball in a floor", "ball in a floor, floor, seen by a wall", "lamp in a ceiling, lamp"),
    (0.2, 2048): ("cubes of a mesh, seen by a wall",),
    (0.3, 1024): ("cubes of a mesh, in a mirror", "lamp in a ceiling, ceiling", "lamp in a ceiling, by way of a wall"),
}
ROWS = [Row(name, bias, spp) for (bias, spp), names in SHOWN.items() for name in names]
QUICK = ("walls that cross",)  # lines of textures have `boundary/test_texture_lines.py` and `test_mirrors.py`


def test_every_scene_is_examined():
    assert sorted(row.name for row in ROWS) == sorted(INNER_JUMPS)


@pytest.mark.parametrize("row", deep_but([row for row in ROWS if row.name in QUICK], ROWS), ids=str)
def test_derivatives_are_those_of_finite_differences(row):
    """And if they were wrong by the stated bias, that would be noticed."""
    measured = Estimate(INNER_JUMPS[row.name], Effort(row.spp, BATCHES))
    measured.add_round()
    assert_agrees(measured, row, ("agrees", "too noisy"))
