"""On a GPU: derivatives of jumps, forward mode, rays of one's own and windows are those of the processor; loops of training
run there by default settings. Skipped without one; `make gpu-check` runs them.
"""

import pytest
import torch

import torch_radbp as rb
from tests.gradients import assert_informative, cotangent, relative_error, unwarned_renderer
from tests.scenes import CASES, cornell
from tests.scenes.cut_outs import CUT_OUTS
from tests.scenes.mirrors import MIRRORED
from tests.scenes.moving import SCENES as MOVING
from tests.scenes.shadows import SHADOWS

pytestmark = [pytest.mark.gpu, pytest.mark.filterwarnings("error:.*runs eagerly:RuntimeWarning")]
DEVICE = "cuda"
JUMPS = {f"{kind}: {name}": scenes[name] for kind, scenes, every in (
    ("edges", MOVING, 9), ("shadows", SHADOWS, 5), ("cut-outs", CUT_OUTS, 6), ("mirrors", MIRRORED, 4))
    for name in list(scenes)[::every] if name != "distances" and "ball" not in name}  # too many triangles for `brute`


def gradient_of(moving, device: str) -> tuple[torch.Tensor, torch.Tensor]:
    """Image and gradient, on the CPU."""
    scene = moving.build().to(device)
    wanted = scene.get_parameter(moving.name).requires_grad_()
    renderer = unwarned_renderer(scene, spp=16, max_depth=moving.max_depth, rr_depth=100, sampling=moving.samplings[0],
                                 caster="brute")
    image = renderer(seed=3)
    gradient, = torch.autograd.grad(image, wanted, cotangent(image.detach().cpu()).to(device))
    return image.detach().cpu(), gradient.cpu()


@pytest.mark.parametrize("name", JUMPS)
def test_the_derivative_of_jumps(name):
    """By the same rays. Rounding decides by which of two pixels some curves in mirrors are found."""
    (expected, wanted), (image, found) = gradient_of(JUMPS[name], "cpu"), gradient_of(JUMPS[name], DEVICE)
    assert_informative(expected, [wanted])
    assert relative_error(image, expected) < 1e-9
    assert relative_error(found, wanted) < (0.05 if name.startswith("mirrors") else 1e-6)


@pytest.mark.parametrize("name", ["light.emitter.radiance.value", "box.to_world"])
def test_forward_mode(name):
    def derivative(device: str) -> torch.Tensor:
        scene = cornell(torch.float64, 16).to(device)
        direction = cotangent(scene.get_parameter(name).cpu()).to(device)
        return rb.jvp(scene, {name: direction}, spp=8, max_depth=4, caster="brute").cpu()

    expected = derivative("cpu")
    assert expected.isfinite().all() and expected.any()
    assert relative_error(derivative(DEVICE), expected) < 1e-6


def test_windows_and_rays_of_ones_own():
    def rendered(device: str) -> list[torch.Tensor]:
        scene = cornell(torch.float64, 16).to(device)
        renderer = unwarned_renderer(scene, spp=4, max_depth=4, caster="brute")
        origins = torch.zeros(50, 3, dtype=torch.float64, device=device)
        directions = cotangent(torch.zeros(50, 3, dtype=torch.float64)).to(device)
        return [renderer(seed=1, window=(2, 3, 8, 5)).cpu(), renderer.radiance(origins, directions, seed=1, spp=4).cpu()]

    for found, expected in zip(rendered(DEVICE), rendered("cpu")):
        assert expected.isfinite().all() and expected.any()
        assert relative_error(found, expected) < 1e-9


def test_a_loop_of_training_by_default_settings():
    """The light's colour comes back."""
    scene = cornell(torch.float32, 32).to(DEVICE)
    names = ("light.emitter.radiance.value", *CASES["cornell"].parameters[:1])
    renderer = rb.Renderer(scene, spp=16, max_depth=4)
    with torch.no_grad():
        target = rb.Renderer(scene, spp=256, max_depth=4)(seed=999)
    light = scene.get_parameter(names[0])
    truth = light.detach().clone()
    with torch.no_grad():
        light.mul_(0.5)
    light.requires_grad_()
    optimizer = torch.optim.Adam([light], lr=0.3)
    for step in range(60):
        optimizer.zero_grad()
        (renderer(seed=step) - target).square().mean().backward()
        optimizer.step()
    assert relative_error(light.detach(), truth) < 0.05
