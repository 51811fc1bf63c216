"""What derivatives lack is told from noise."""

import pytest
import torch

import torch_radbp as rb
from benchmarks import left_out
from benchmarks.left_out import Case, lack
from tests.scenes import GLOW, load


def moving_sheet() -> Case:
    """A sheet that shines, whose left edge is in view and moves to the right."""
    view = {"type": "orthographic", "film": left_out.FILM, "near_clip": 0.1}
    corners = torch.tensor([[-0.3, -2.0, 1.0], [2.0, -2.0, 1.0], [2.0, 2.0, 1.0], [-0.3, 2.0, 1.0]])
    sheet = {"type": "mesh", "vertex_positions": corners, "faces": torch.tensor([[0, 2, 1], [0, 3, 2]]),
             "emitter": GLOW}
    right = torch.tensor([1.0, 0.0, 0.0])
    return Case(lambda: load(torch.float32, sensor=view, sheet=sheet), "sheet.vertex_positions",
                lambda home, way: home + way * right, lambda at: right.expand_as(at).contiguous(), 0.1, 1, 64)


@pytest.mark.parametrize("missing", [False, True])
def test_what_derivatives_lack_is_told(missing, monkeypatch):
    if missing:
        found = rb.jvp
        monkeypatch.setattr(rb, "jvp", lambda *arguments, **more: 0.5 * found(*arguments, **more))
    rest, noise = lack(moving_sheet())
    assert 0 < noise < 0.1
    assert rest == pytest.approx(0.5, abs=0.1) if missing else rest < 3 * noise


def test_velocities_are_those_of_what_moves():
    for case in left_out.cases().values():
        scene = case.build()
        vertices = scene.get_parameter(case.name).detach()
        assert case.moved(vertices, 0.0).allclose(vertices, atol=1e-6)
        step = (case.moved(vertices, 1e-2) - case.moved(vertices, -1e-2)) / 2e-2
        assert step.allclose(case.velocity(vertices), atol=1e-3) and step.abs().max() > 0.1
