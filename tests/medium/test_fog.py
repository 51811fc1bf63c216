"""A medium is a folder: a fog that absorbs is made in `fog/`, and the tracer renders and differentiates it.

Closed forms along camera rays, shadow rays and in mirrors; the gradient of every strategy, stride and way of running against
the tape's; forward mode as the transpose of backward; differences.
"""

from __future__ import annotations

import math
from itertools import product

import pytest
import torch

import torch_radbp as rb
from tests.deep import deep
from tests.gradients import FEW, SOME, cotangent, image_and_gradients, relative_error
from tests.scenes import diffuse, load, overhead, rectangle, rgb
from torch_radbp.plugin import REGISTRY, register

SIGMA = (0.25, 0.5, 0.875)
FOG = {"type": "absorbing_fog", "sigma_a": rgb(*SIGMA)}
NAME = "camera.medium.sigma_a.value"
MIRROR = {"type": "conductor", "material": "none"}
NEAR = 0.01  # from the camera to where its rays begin, the near plane
SETTINGS = {"spp": 8, "max_depth": 4, "rr_depth": 2}


@pytest.fixture(autouse=True, scope="module")
def registered():
    """The fog is registered while it is tested: the rest of the tests go over all that the package has."""
    from tests.medium.fog import AbsorbingFog

    register("medium", "absorbing_fog")(AbsorbingFog)
    yield
    del REGISTRY["medium"]["absorbing_fog"]


def lamp(at, half, radiance=(3.0, 2.0, 1.0), **more):
    return rectangle(at, half, bsdf=diffuse(0, 0, 0), emitter={"type": "area", "radiance": rgb(*radiance)}, **more)


def room(**more):
    """A floor under a lamp and a point light, beside a mirror, from above, in fog."""
    return load(torch.float64, camera=overhead(4, 4.0, 1.0) | {"medium": FOG},
                floor=rectangle((0, 0, 0), 2.0, bsdf=diffuse(0.6, 0.5, 0.4)),
                mirror=rectangle((0.9, 0, 0.5), 0.5, (0, 1, 0), -60, bsdf={"type": "twosided", "one": MIRROR}),
                lamp=lamp((0.3, -0.8, 2.0), 0.4, axis=(1, 0, 0), angle=170),
                bulb={"type": "point", "position": [-0.5, 0.6, 1.5], "intensity": rgb(2, 3, 4)}, **more)


def derivative(scene, **settings) -> torch.Tensor:
    """By forward mode, in each colour that of its own absorption."""
    return rb.jvp(scene, {NAME: torch.ones_like(scene.get_parameter(NAME))}, seed=1, **settings)


def assert_closed_form(scene, expected: torch.Tensor, distance: float, **settings) -> None:
    """An image is `expected`, and its derivative by the absorption -distance times that, by colour."""
    image, forward = rb.render(scene, seed=1, **settings), derivative(scene, **settings)
    expected = expected[None, :, None, None]
    torch.testing.assert_close(image, expected.expand_as(image), rtol=1e-9, atol=0)
    torch.testing.assert_close(forward, (-distance * expected).expand_as(image), rtol=1e-9, atol=0)
    assert (image > 0).all()
    _, (gradient,) = image_and_gradients(scene, [NAME], adj_image=torch.ones_like(image), **settings)
    torch.testing.assert_close(gradient.flatten(), forward.sum((0, 2, 3)), rtol=1e-9, atol=0)


@pytest.mark.parametrize("compile", [False, True], ids=["eager", "compiled"])
def test_what_a_camera_ray_meets_is_darker_by_its_distance(compile):
    scene = load(torch.float64, camera=overhead(4, 4.0, 1.0) | {"medium": FOG}, lamp=lamp((0, 0, 1), 2.0))
    expected = torch.tensor([3.0, 2.0, 1.0]) * torch.exp(-(3.0 - NEAR) * torch.tensor(SIGMA, dtype=torch.float64))
    assert_closed_form(scene, expected, 3.0 - NEAR, spp=2, max_depth=2, compile=compile)


@pytest.mark.parametrize("compile", [False, True], ids=["eager", "compiled"])
def test_light_from_a_mirror_is_darker_by_the_whole_way(compile):
    """Looking down onto a mirror at 45 degrees, and from there sideways at a lamp: 4 + 2."""
    scene = load(torch.float64, camera=overhead(2, 4.0, 1e-4) | {"medium": FOG},
                 mirror=rectangle((0, 0, 0), 1.0, (0, 1, 0), 45, bsdf=MIRROR),
                 lamp=lamp((2, 0, 0), 1.0, axis=(0, 1, 0), angle=-90))
    expected = torch.tensor([3.0, 2.0, 1.0]) * torch.exp(-(6.0 - NEAR) * torch.tensor(SIGMA, dtype=torch.float64))
    image = rb.render(scene, spp=2, max_depth=3, compile=compile, seed=1)
    torch.testing.assert_close(image, expected[None, :, None, None].expand_as(image), rtol=1e-3, atol=0)
    forward = derivative(scene, spp=2, max_depth=3, compile=compile)
    torch.testing.assert_close(forward, (NEAR - 6.0) * image, rtol=1e-3, atol=0)


@pytest.mark.parametrize("compile", [False, True], ids=["eager", "compiled"])
def test_light_that_is_sampled_is_darker_by_the_way_from_the_lamp(compile):
    """A point light 1 above a floor that the camera sees from 4: reflectance / pi x intensity x transmittance of 1 + 4."""
    scene = load(torch.float64, camera=overhead(2, 4.0, 1e-4) | {"medium": FOG},
                 floor=rectangle((0, 0, 0), 2.0, bsdf=diffuse(0.6, 0.5, 0.4)),
                 bulb={"type": "point", "position": [0.0, 0.0, 1.0], "intensity": rgb(2, 3, 4)})
    expected = torch.tensor([1.2, 1.5, 1.6]) / math.pi * torch.exp(-(5.0 - NEAR) * torch.tensor(SIGMA, dtype=torch.float64))
    image = rb.render(scene, spp=2, max_depth=2, compile=compile, seed=1)
    torch.testing.assert_close(image, expected[None, :, None, None].expand_as(image), rtol=1e-3, atol=0)
    forward = derivative(scene, spp=2, max_depth=2, compile=compile)
    torch.testing.assert_close(forward, (NEAR - 5.0) * image, rtol=1e-3, atol=0)


def test_a_sky_is_not_seen_through_it():
    """Nor behind nothing: it fills all space."""
    sky = {"type": "constant", "radiance": rgb(1, 1, 1)}
    floor = rectangle((0, 0, 0), 0.5, bsdf=diffuse(0.6, 0.5, 0.4))
    dark, bright = (rb.render(load(torch.float64, camera=overhead(4) | more, sky=sky, floor=floor), seed=1, spp=4,
                              max_depth=3) for more in ({"medium": FOG}, {}))
    assert dark.max() == 0 and bright.min() > 0


@pytest.mark.parametrize("compile, sampling, strategies", [
    pytest.param(True, "hybrid", SOME, id="compiled-hybrid"), pytest.param(False, "attached", FEW, id="eager-few"),
    *(deep(compile, sampling, SOME) for compile, sampling in product((False, True), ("detached", "hybrid", "attached"))
      if (compile, sampling) != (True, "hybrid"))])
def test_every_strategy_and_stride_gives_the_gradient_of_the_tape(compile, sampling, strategies):
    """Of the absorption, and of what moves in it."""
    names = [NAME, "floor.bsdf.reflectance.value", "lamp.emitter.radiance.value", "bulb.position", "mirror.to_world"]
    settings = SETTINGS | {"sampling": sampling}
    scene = room()
    image, expected = image_and_gradients(scene, names, **settings | {"adjoint": rb.TapeAdjoint()})
    for name, gradient in zip(names, expected):
        assert torch.isfinite(gradient).all() and gradient.abs().max() > 0, name
    for adjoint in strategies:
        found, gradients = image_and_gradients(scene, names, compile=compile, **settings | {"adjoint": adjoint})
        assert relative_error(found, image) < 1e-12
        for name, gradient, wanted in zip(names, gradients, expected):
            assert relative_error(gradient, wanted) < 1e-10, (adjoint, name)


@pytest.mark.parametrize("compile", [False, True], ids=["eager", "compiled"])
def test_forward_mode_is_the_transpose_of_backward(compile):
    scene = room()
    forward = derivative(scene, compile=compile, **SETTINGS)
    w = cotangent(forward)
    _, (gradient,) = image_and_gradients(scene, [NAME], seed=1, adj_image=w, compile=compile, **SETTINGS)
    assert float(gradient.sum()) == pytest.approx(float((w * forward).sum()), rel=1e-10)


def test_derivatives_are_those_of_differences():
    """Of one and the same paths, which absorption does not change but for roulette, which is off here."""
    scene, settings = room(), SETTINGS | {"rr_depth": 100, "share_samples": True}
    forward, step = derivative(scene, **settings), 1e-5
    images = []
    for sign in (1, -1):
        scene.get_parameter(NAME).data += sign * step
        images.append(rb.render(scene, seed=1, **settings))
        scene.get_parameter(NAME).data -= sign * step
    assert forward.abs().max() > 0
    assert relative_error((images[0] - images[1]) / (2 * step), forward) < 1e-7


def test_a_medium_that_is_not_known_is_refused_by_name():
    with pytest.raises(rb.SceneError, match="absorbing_fog"):
        load(torch.float64, camera=overhead(4) | {"medium": {"type": "absorbing_fgo"}}, lamp=lamp((0, 0, 0), 1.0))
