"""Every strategy, stride and schedule gives the derivative of plain autograd, for every parameter, and so does forward mode.

Nor does anything depend on chunks, on other sensors or on the ray caster.

Scenes that together have every plugin; for each way of sampling the same paths.
"""

import pytest
import torch

import torch_radbp as rb
from tests.deep import deep, deep_but
from tests.gradients import cotangent, image_and_gradients, relative_error, unwarned_renderer
from tests.scenes import parameters
from tests.scenes.every_plugin import SCENES, build, subjects
from tests.scenes.everything import EVERYTHING, build_everything
from tests.scenes.pairs import examined, registered
from tests.scenes.parts import camera

ORACLE, TRANSPOSED = 1e-10, 1e-12
pytestmark = pytest.mark.filterwarnings("ignore::torch_radbp.SilhouetteWarning")
# Eager, as most scenes here are like no other and would be compiled for a single test.
SETTINGS = {"spp": 2, "max_depth": 4, "rr_depth": 2, "compile": False}
SPP = {"materials": 4, "shapes": 2, "textures": 4, "lamps": 4, "fog": 4, "smoke": 16}  # by which paths find every parameter
SAMPLINGS = ("detached", "hybrid", "attached")
# One of each kind: what is compiled differs by whether bounces are replayed, traced again, or kept, not by the stride.
KINDS = (rb.MemoizedAdjoint(1), rb.MemoizedAdjoint(3), rb.MemoizedAdjoint("log", keep_hits=False), rb.ReplayAdjoint(),
         rb.QuadraticAdjoint())
STRATEGIES = (rb.MemoizedAdjoint(1), rb.MemoizedAdjoint(2), rb.MemoizedAdjoint(3), rb.MemoizedAdjoint("sqrt"),
              rb.MemoizedAdjoint("log"), rb.MemoizedAdjoint(2, keep_hits=False), rb.ReplayAdjoint(), rb.QuadraticAdjoint())


def gradients_of(build, names, **settings):
    """The image and the gradients of its product with a fixed cotangent."""
    return image_and_gradients(build(), names, **SETTINGS | settings)


def assert_same(names, gradients, expected, tolerance: float) -> None:
    for name, gradient, wanted in zip(names, gradients, expected):
        error = relative_error(gradient, wanted)
        assert error < tolerance, f"{name}: relative error {error:.1e}"


def test_the_scenes_have_everything():
    missing = registered() - set().union(*(examined(build_everything(name)) for name in EVERYTHING))
    assert not missing, missing


@pytest.mark.parametrize("sampling, strategies, compiled", [
    ("hybrid", KINDS, False), *(deep(sampling, STRATEGIES, False) for sampling in SAMPLINGS), deep("hybrid", KINDS, True)])
@pytest.mark.parametrize("name", deep_but(["lamps"], EVERYTHING))
def test_every_strategy_gives_the_gradient_of_the_tape(name, sampling, strategies, compiled):
    def scene():
        return build_everything(name)

    names = subjects(scene())
    image, expected = gradients_of(scene, names, spp=SPP[name], sampling=sampling, adjoint=rb.TapeAdjoint())
    assert torch.isfinite(image).all() and image.max() > 0
    for parameter, gradient in zip(names, expected):
        assert torch.isfinite(gradient).all() and gradient.abs().max() > 0, parameter
    for adjoint in strategies:
        found, gradients = gradients_of(scene, names, spp=SPP[name], sampling=sampling, adjoint=adjoint, compile=compiled)
        assert relative_error(found, image) < 1e-12, adjoint
        assert_same([f"{adjoint}: {parameter}" for parameter in names], gradients, expected, ORACLE)


@pytest.mark.parametrize("sampling", deep_but(["hybrid"], SAMPLINGS))
@pytest.mark.parametrize("name", deep_but(["lamps"], EVERYTHING))
def test_forward_is_the_transpose_of_backward(name, sampling):
    scene = build_everything(name)
    names = subjects(scene)
    generator = torch.Generator().manual_seed(8)
    tangents = {parameter: torch.randn(scene.get_parameter(parameter).shape, generator=generator, dtype=torch.float64)
                for parameter in names}
    settings = SETTINGS | {"spp": SPP[name], "sampling": sampling}
    derivative = rb.jvp(scene, tangents, seed=8, **settings)
    assert torch.isfinite(derivative).all() and derivative.abs().max() > 0
    wanted = parameters(scene, names)
    image = unwarned_renderer(scene, **settings)(seed=8)
    seen = torch.zeros(len(names), dtype=torch.bool)
    for w in (torch.ones_like(derivative), derivative, cotangent(derivative)):
        gradients = torch.autograd.grad(image, wanted, w, retain_graph=True)
        terms = torch.stack([(tangents[parameter] * gradient).sum() for parameter, gradient in zip(names, gradients)])
        assert abs(terms.sum() - (w * derivative).sum()) < TRANSPOSED * terms.abs().sum()
        seen |= terms.abs() > 100 * TRANSPOSED * terms.abs().sum()
    assert seen.all()  # a term that one of the two leaves out


@pytest.mark.parametrize("name", deep_but(["rough metal ggx"], ["rectangle", "rough metal ggx", "spot", "perspective"]))
def test_hybrid_is_detached_where_no_mirror_and_no_glass_is(name):
    names = subjects(build(name))
    (_, hybrid), (_, detached) = (gradients_of(lambda: build(name), names, sampling=sampling)
                                  for sampling in ("hybrid", "detached"))
    assert all(gradient.abs().max() > 0 for gradient in hybrid)
    assert_same(names, hybrid, detached, 1e-14)


@pytest.mark.parametrize("name, parameter", [
    ("conductor", "subject_plane.to_world"), ("rough glass ggx", "subject.alpha.value"),
    deep("dielectric", "subject.eta"), deep("rough glass beckmann", "subject.eta")])
def test_hybrid_is_not_detached_where_a_mirror_or_glass_is(name, parameter):
    (_, (hybrid,)), (_, (detached,)) = (
        gradients_of(lambda: build(name), [parameter], sampling=sampling, share_samples=True)
        for sampling in ("hybrid", "detached"))
    assert relative_error(hybrid, detached) > 0.01


@pytest.mark.parametrize("sampling", deep_but(["hybrid"], SAMPLINGS))
@pytest.mark.parametrize("name", deep_but(["lamps"], EVERYTHING))
def test_chunks_do_not_matter(name, sampling):
    def scene():
        return build_everything(name)

    whole = scene()
    sensors = list(range(len(whole.sensors)))[:2]  # of many cameras two: chunks are the same thing for all
    left_out = tuple(whole.name_of(sensor) + "." for sensor in whole.sensors[2:])
    names = [parameter for parameter in subjects(whole) if not parameter.startswith(left_out)]
    image, expected = gradients_of(scene, names, spp=SPP[name], sampling=sampling, sensors=sensors)
    found, gradients = gradients_of(scene, names, spp=SPP[name], sampling=sampling, sensors=sensors, chunk=300)
    assert relative_error(found, image) < 1e-14
    assert_same(names, gradients, expected, 1e-11)


@pytest.mark.parametrize("sampling", deep_but(["hybrid"], SAMPLINGS))
@pytest.mark.parametrize("name", deep_but(["flat mesh", "brushed glass ggx"], [
    "cube", "flat mesh", "dielectric", "brushed glass ggx", "area of a mesh", "projector"]))
def test_the_ray_caster_does_not_matter(name, sampling):
    names = subjects(build(name))
    image, expected = gradients_of(lambda: build(name), names, sampling=sampling)
    found, gradients = gradients_of(lambda: build(name), names, sampling=sampling, caster="brute")
    assert image.max() > 0 and relative_error(found, image) < 1e-11
    assert_same(names, gradients, expected, 1e-9)


@pytest.mark.parametrize("sampling", deep_but(["hybrid"], SAMPLINGS))
def test_gradients_of_several_sensors_add_up(sampling):
    """Each camera has its own gradient; what they share has the sum."""
    def scene():
        return build("dielectric", subject_left=camera(2, 30), subject_right=camera(2, 50))

    names = subjects(scene())
    cameras = [n for n in names if n.startswith(("subject_left", "subject_right"))]
    assert len(cameras) == 8
    sensors = [1, 2]
    image, together = gradients_of(scene, names, sampling=sampling, sensors=sensors, seed=4)
    w = cotangent(image)
    parts = []
    for place, sensor in enumerate(sensors):
        alone = build("dielectric", subject_left=camera(2, 30), subject_right=camera(2, 50))
        wanted = [alone.get_parameter(n).requires_grad_() for n in names]
        found = rb.Renderer(alone, sampling=sampling, **SETTINGS)(seed=4, sensors=[sensor])
        assert relative_error(found.detach(), image[place:place + 1]) < 1e-14
        gradients = torch.autograd.grad(found, wanted, w[place:place + 1], allow_unused=True)
        parts.append([torch.zeros_like(p) if g is None else g for p, g in zip(wanted, gradients)])
    assert all(gradient.abs().max() > 0 for gradient in together)
    assert_same(names, together, [a + b for a, b in zip(*parts)], 1e-11)


@pytest.mark.parametrize("sampling", deep_but(["hybrid"], SAMPLINGS))
@pytest.mark.parametrize("adjoint", STRATEGIES, ids=repr)
def test_the_backward_pass_casts_no_ray_if_hits_are_kept(adjoint, sampling):
    scene = build("dielectric")
    wanted = [scene.get_parameter(name).requires_grad_() for name in subjects(scene)]
    renderer = rb.Renderer(scene, adjoint=adjoint, sampling=sampling, share_samples=True, **SETTINGS)
    image = renderer(seed=3)
    before = renderer.last_caster.rays_cast
    gradients = torch.autograd.grad(image, wanted, cotangent(image.detach()))
    assert before > 0 and all(gradient.abs().max() > 0 for gradient in gradients)
    assert (renderer.last_caster.rays_cast == before) == adjoint.keep_hits


@pytest.mark.parametrize("sampling", deep_but(["hybrid"], SAMPLINGS))
def test_the_backward_pass_can_have_samples_of_its_own(sampling):
    names = [*subjects(build("perspective")), "plane.to_world"]

    def gradients(seed, seed_grad):
        scene = build("perspective")
        wanted = [scene.get_parameter(name).requires_grad_() for name in names]
        image = rb.Renderer(scene, sampling=sampling, **SETTINGS)(seed=seed, seed_grad=seed_grad)
        return image.detach(), torch.autograd.grad(image, wanted, cotangent(image.detach()))

    image, expected = gradients(8, 8)
    other, found = gradients(3, 8)
    assert not torch.equal(image, other) and all(gradient.abs().max() > 0 for gradient in expected)
    assert_same(names, found, expected, 1e-14)


@pytest.mark.deep
def test_all_scenes_have_an_image():
    for name in SCENES:
        image = rb.render(build(name), seed=3, **SETTINGS)
        assert torch.isfinite(image).all() and image.max() > 0, name
