"""Ways by mirrors and glass are followed by machine code that is recorded: gradients have the bits of single operations."""

import pytest
import torch

import torch_radbp as rb
from tests.deep import deep_but
from tests.gradients import cotangent
from tests.scenes import load
from tests.scenes.mirrors import BALL, CUBE, LENS, MIRROR, SKY, VIEWED
from torch_radbp.boundary.eye import differences, ideal_steps
from torch_radbp.jit.cpu.recorded import Recorded
from torch_radbp.jit.tape import Tape

pytestmark = pytest.mark.filterwarnings("ignore::torch_radbp.SilhouetteWarning")
SCENES = {"ball": {"ball": BALL, "cube": CUBE}, "lens": {"lens": LENS, "cube": CUBE},
          "mirror": {"mirror": MIRROR, "cube": CUBE}, "three kinds": {"mirror": MIRROR, "ball": BALL, "lens": LENS}}


def gradient(objects: dict) -> torch.Tensor:
    """That of the camera's pose, of what jumps in view and by way of mirrors."""
    scene = load(torch.float32, sensor=VIEWED, sky=SKY, **objects).requires_grad_(False)
    pose = scene.get_parameter("sensor.to_world").requires_grad_()
    image = rb.render(scene, seed=3, spp=8, max_depth=5, terms=("primary",), compile=True)
    return torch.autograd.grad(image, pose, cotangent(image.detach()))[0]


@pytest.mark.parametrize("name", deep_but(["ball", "three kinds"], SCENES))
def test_gradients_have_the_same_bits(name, monkeypatch):
    called, call = [], Recorded.__call__
    monkeypatch.setattr(Recorded, "__call__", lambda *given, **named: called.append(given) or call(*given, **named))
    recorded, steps, parting = gradient(SCENES[name]), [], []
    once, step = len(called), ideal_steps.ideal_step

    class NothingPlayed(Tape):
        def play(self, *rest):
            parting.append(rest)

    monkeypatch.setattr(differences, "Tape", NothingPlayed)
    monkeypatch.setattr(ideal_steps, "recordable", lambda integrand: False)
    monkeypatch.setattr(ideal_steps, "ideal_step", lambda *rest: steps.append(rest) or step(*rest))
    singly = gradient(SCENES[name])
    assert len(steps) > 3 and len(parting) > 3 and len(called) == 2 * once - len(steps) - len(parting)
    assert torch.isfinite(singly).all() and singly.abs().max() > 1e-3
    assert torch.equal(recorded, singly)
