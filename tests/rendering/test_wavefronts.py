"""Small images of several sensors, which are traced as one: each is what it is alone."""

import pytest
import torch

import torch_radbp as rb
from tests.gradients import relative_error
from tests.scenes import cornell, look_at, sensor

NAMES = ["white.reflectance.value", "light.emitter.radiance.value"]
POSES = ["first.to_world", "second.to_world", "blurred.to_world"]
SETTINGS = {"spp": 4, "max_depth": 4, "rr_depth": 2}


def room(dtype=torch.float64, **far) -> rb.Scene:
    """A Cornell box with three sensors, the last of another kind."""
    views = {"first": sensor(6, to_world=look_at((-0.4, 0, 3.9), (0, 0, 0), (0, 1, 0))),
             "second": sensor(6, to_world=look_at((0.1, 0.2, 3.9), (0, 0.1, 0), (0, 1, 0))) | far,
             "blurred": sensor(6, type="thinlens", aperture_radius=0.1, focus_distance=3.5,
                               to_world=look_at((0.3, 0, 3.9), (0, 0, 0), (0, 1, 0)))}
    scene = cornell(dtype, sensors=views)
    for name in (*NAMES, *POSES):
        scene.get_parameter(name).requires_grad_()
    return scene


def wavefronts(renderer: rb.Renderer) -> list[list[int]]:
    return [[chunk.sensor for chunk in wavefront.chunks] for wavefront in renderer.prepare(1, None, None, None).wavefronts]


@pytest.mark.parametrize("share_samples", [False, True])
@pytest.mark.parametrize("adjoint", [rb.MemoizedAdjoint(), rb.MemoizedAdjoint(2, keep_hits=False), rb.ReplayAdjoint()],
                         ids=repr)
def test_images_and_gradients_are_those_of_the_sensors_alone(adjoint, share_samples):
    scene = room()
    renderer = rb.Renderer(scene, adjoint=adjoint, share_samples=share_samples, terms=("interior",), **SETTINGS)
    assert wavefronts(renderer) == [[0, 1], [2]]
    generator = torch.Generator().manual_seed(1)
    cotangent = torch.rand(3, 3, 6, 6, generator=generator, dtype=torch.float64)
    values = [scene.get_parameter(name) for name in (*NAMES, *POSES)]
    images = renderer(seed=1)
    gradients = torch.autograd.grad((images * cotangent).sum(), values)
    alone = [renderer(seed=1, sensors=number) for number in range(3)]
    expected = torch.autograd.grad(sum((image * own).sum() for image, own in zip(alone, cotangent)), values)
    assert images.std() > 0.01 and torch.equal(images, torch.cat(alone))
    for gradient, own in zip(gradients, expected):
        assert own.abs().max() > 1e-3 and relative_error(gradient, own) < 1e-12


def test_so_are_quantities_and_tangents():
    scene = room()
    renderer = rb.Renderer(scene, terms=("interior",), **SETTINGS)
    names = ["depth", "albedo", "alpha"]
    image, beside = renderer(seed=1, aovs=names)
    for number in range(3):
        alone, own = renderer(seed=1, aovs=names, sensors=number)
        assert torch.equal(image[number], alone[0]) and own["depth"].max() > 1
        assert all(torch.equal(beside[name][number], own[name][0]) for name in names)
    tangent = {NAMES[0]: torch.tensor([0.3, -0.2, 0.1], dtype=torch.float64)}
    found = rb.jvp(scene, tangent, seed=1, **SETTINGS)
    alone = [rb.jvp(scene, tangent, seed=1, sensors=number, **SETTINGS) for number in range(3)]
    assert found.abs().max() > 0.01 and torch.equal(found, torch.cat(alone))


def test_what_is_eager_or_clipped_by_a_far_plane_is_traced_alone():
    assert wavefronts(rb.Renderer(room(), compile=False, **SETTINGS)) == [[0], [1], [2]]
    assert wavefronts(rb.Renderer(room(), chunk=200, **SETTINGS)) == [[0], [1], [2]]
    scene = room(far_clip=3.0)
    renderer = rb.Renderer(scene, terms=("interior",), **SETTINGS)
    assert wavefronts(renderer) == [[0], [1], [2]]
    images = renderer(seed=1)
    assert torch.equal(images[1], renderer(seed=1, sensors="second")[0])
    assert relative_error(images[1], rb.Renderer(room(), **SETTINGS)(seed=1)[1]) > 0.1
