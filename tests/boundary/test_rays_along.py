"""Vertices behind glass and mirrors follow the rays that reach them: derivatives by the vertices' own states are those that
autograd records."""

import pytest
import torch

import torch_radbp as rb
from benchmarks import caustic_noise
from torch_radbp.adjoint.attached import rays_reaching
from torch_radbp.boundary.eye import viewpoints

pytestmark = pytest.mark.filterwarnings("ignore::torch_radbp.SilhouetteWarning")

NAMES = "ball.to_world", "ball.bsdf.eta", "camera.to_world"
STRAIGHT = "lamp.to_world"  # moves nothing on the way from the camera


def gradients(names: tuple[str, ...], seed: int) -> list[torch.Tensor]:
    """The derivatives by what moves of what a glass ball's surroundings lose at edges."""
    description, _ = caustic_noise.SCENES["glass ball"]
    scene = rb.load_dict(description)
    moving = [scene.get_parameter(name).requires_grad_() for name in names]
    image = rb.render(scene, spp=64, seed=seed, terms=("shadow",), light_paths="camera")
    return list(torch.autograd.grad(caustic_noise.loss_of(image), moving))


def test_derivatives_are_those_that_autograd_records(monkeypatch):
    rays_along, counts = viewpoints.rays_along, []

    def noted(integrand, start, depth, met, scene):
        counts.append(len(depth))
        return rays_along(integrand, start, depth, met, scene)

    def recorded(integrand, start, depth, met, scene):
        return rays_reaching(integrand._replace(scene=scene, parts={}), start, depth)

    for seed in range(2):
        monkeypatch.setattr(viewpoints, "rays_along", noted)
        found = gradients((*NAMES, STRAIGHT), seed)
        monkeypatch.setattr(viewpoints, "rays_along", recorded)
        for own, expected in zip(found, gradients((*NAMES, STRAIGHT), seed)):
            assert expected.abs().max() > 0
            assert (own - expected).abs().max() < 1e-4 * expected.abs().max()
    assert min(counts) > 10
