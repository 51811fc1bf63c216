"""The comparison at rims tells a right derivative from a wrong one."""

import pytest

from benchmarks import rims
from tests.scenes.meshes import icosphere


@pytest.mark.parametrize("doubled", [False, True])
def test_a_row_has_an_asterisk_where_the_derivative_is_wrong(doubled, monkeypatch):
    monkeypatch.setattr(rims, "FEWEST", 4)
    monkeypatch.setattr(rims.Measurement, "backward", lambda self, seed: (1 + doubled) * self.difference(seed + 1000))
    shape = rims.mesh(*icosphere(1), **rims.GLOW)
    case = rims.Case({"camera": rims.camera(), "shape": shape}, "shape.vertex_positions", rims.grown, 1)
    found = rims.measured(case, noise=0.05, most=8)
    assert found[0].value > 0
    assert rims.row("ball", found, 0.0).endswith("* | 0 |") == doubled


def test_balls_have_as_many_triangles_as_asked_for():
    for triangles in (100, 1000, 10_000):
        assert len(rims.ball(triangles)["faces"]) == pytest.approx(triangles, rel=0.05)
