"""Compiled renderings: the eager image and gradient, from functions that are compiled once."""

import pytest
import torch

import torch_radbp as rb
from tests.deep import deep, deep_but
from tests.gradients import assert_informative, cotangent, image_and_gradients, relative_error
from tests.scenes import CASES, cornell, parameters
from tests.scenes.everything import EVERYTHING, build_everything
from torch_radbp.boundary.terms import of_call as terms
from torch_radbp.jit import stages
from torch_radbp.path.camera_rays import sample_camera
from torch_radbp.sampling.sampler import film_order, sample_key
from torch_radbp.tensors.differentiated import detached
from torch_radbp.tensors.stage import EAGER

pytestmark = pytest.mark.filterwarnings("error:.*runs eagerly:RuntimeWarning")
SIZE, NAMES = 16, CASES["cornell"].parameters
SETTINGS = {"spp": 4, "max_depth": 5, "rr_depth": 3}


def view_and_gradients(renderer, seed=1, **call):
    wanted = [renderer.scene.get_parameter(name) for name in NAMES]
    image = renderer(seed=seed, **call)
    return image.detach(), torch.autograd.grad(image, wanted, cotangent(image.detach()))


def make(**settings):
    scene = cornell(torch.float32, SIZE)
    parameters(scene, NAMES)
    return rb.Renderer(scene, **SETTINGS | settings)


@pytest.fixture(scope="module")
def compiled():
    """A renderer that has rendered, and walked back, once, with more than a few lanes at each depth for each core.

    Before it one in chunks, whose image and derivative are traced one after the other, and one of so few samples that they
    are traced together.
    """
    renderer = make(compile=True)
    view_and_gradients(make(compile=True, chunk=500))
    view_and_gradients(renderer)
    view_and_gradients(renderer, spp=64)
    return renderer


def test_the_compiled_image_and_gradient_are_the_eager_ones(compiled):
    """Fusing changes roundings of 6e-8, some thousands of which add up; a lane in ten thousand may decide otherwise."""
    expected, gradients = view_and_gradients(make())
    image, found = view_and_gradients(compiled)
    assert_informative(expected, list(gradients))
    differs = ((image - expected).abs() > 1e-4 * expected.max()).any(dim=1)
    assert differs.sum() <= 2  # of 256 pixels
    for name, gradient, wanted in zip(NAMES, found, gradients):
        # One lane of 1024 that takes another way changes a gradient by about a thousandth.
        assert relative_error(gradient, wanted) < (1e-3 if differs.any() else 1e-4), name


@pytest.mark.filterwarnings("ignore::torch_radbp.SilhouetteWarning")
def test_compiled_gradients_of_what_moves_are_the_eager_ones():
    names, scenes = ("light.to_world", "white.reflectance.value", "sensor.x_fov"), [cornell(torch.float32, SIZE), cornell(
        torch.float32, SIZE)]
    (image, gradients), (found_image, found) = (
        image_and_gradients(scene, names, compile=compiled, **SETTINGS) for scene, compiled in zip(scenes, (False, True)))
    assert_informative(image, list(gradients))
    differs = ((found_image - image).abs() > 1e-4 * image.max()).any(dim=1)
    assert differs.sum() <= 2
    for name, gradient, wanted in zip(names, found, gradients):
        assert relative_error(gradient, wanted) < (1e-2 if differs.any() else 1e-3), name


@pytest.fixture
def no_mirrors(monkeypatch):
    """Without jumps that are seen by way of mirrors: where a curve lies on the border of two pixels rounding decides in
    which it is found, and so by which random numbers. `derivatives/test_mirrors.py` has their means."""
    monkeypatch.setattr(terms, "follows_mirrors", lambda call: False)


@pytest.mark.filterwarnings("ignore::torch_radbp.SilhouetteWarning", "ignore::torch_radbp.JumpWarning")
@pytest.mark.parametrize("sampling", ["hybrid", deep("attached")])
@pytest.mark.parametrize("name", deep_but(["fog"], EVERYTHING))
def test_forward_mode_of_every_plugin_and_parameter_compiles_to_what_it_is_eagerly(name, sampling, no_mirrors):
    settings, found = {"spp": 2, "max_depth": 4, "rr_depth": 2, "sampling": sampling}, []
    for compile in (False, True):
        scene = build_everything(name)
        generator = torch.Generator().manual_seed(5)
        tangents = {parameter: torch.randn(value.shape, generator=generator, dtype=value.dtype) * 1e-2
                    for parameter, value in scene.named_parameters()}
        for parameter, tangent in tangents.items():
            if parameter.endswith("to_world"):
                tangent[3] = 0.0
        found.append(rb.jvp(scene, tangents, seed=3, compile=compile, **settings))
    expected, derivative = found
    assert torch.isfinite(expected).all() and expected.abs().max() > 0
    assert relative_error(derivative, expected) < 1e-9


@pytest.mark.filterwarnings("ignore::torch_radbp.SilhouetteWarning", "ignore::torch_radbp.JumpWarning")
@pytest.mark.parametrize("name, sampling, chosen", [
    *((name, "hybrid", {"terms": ["interior"]}) for name in ("lamps", "shapes")),
    *(deep(name, sampling, {}) for name in EVERYTHING for sampling in ("hybrid", "attached"))], ids=str)
def test_every_plugin_and_parameter_compiles_to_what_it_is_eagerly(name, sampling, chosen, no_mirrors):
    settings, results = {"spp": 2, "max_depth": 4, "rr_depth": 2, "sampling": sampling} | chosen, []
    for compile in (False, True):
        scene = build_everything(name)
        names = [name for name, _ in scene.named_parameters()]
        results.append(image_and_gradients(scene, names, compile=compile, **settings))
    (expected, gradients), (image, found) = results
    assert relative_error(image, expected) < 1e-13
    known = 0
    for name, gradient, wanted in zip(names, found, gradients):
        largest = wanted.abs().max()
        if largest > 1e-9:  # else it is rounding, as of texture coordinates that nothing reads
            assert relative_error(gradient, wanted) < 1e-10, name
            known += 1
        else:
            assert gradient.abs().max() < 1e-8, name
    assert known > 0.7 * len(names)


def test_camera_rays_in_double_precision():
    camera = detached(cornell(torch.float64, SIZE).sensors[0].tensors())
    numbers = torch.arange(256, dtype=torch.int32)
    key = sample_key(3, 0, True, numbers.device)
    arguments = camera, film_order(SIZE, 7, numbers.device), numbers, numbers % 7, key, False
    (expected, *_), (ray, *_) = (run(sample_camera)(*arguments) for run in (EAGER, stages.compiled()))
    for part, wanted in zip((*ray.o, *ray.d), (*expected.o, *expected.d)):
        assert part.dtype == torch.float64 and (part - wanted).abs().max() < 1e-14
    assert expected.d.x.std() > 0.01


def functions() -> int:
    """How many functions this process has compiled."""
    return sum(len(stage.fused.compiled) for stage in stages.compiled())


VARIATIONS = {
    "another seed": ({}, {"seed": 2**40 + 7}),
    "an independent backward pass": ({}, {"seed": 3, "seed_grad": 4}),
    "more samples": ({}, {"spp": 7}),
    "chunks": ({"chunk": 300}, {}),
    "chunks of a prime": ({"chunk": 997}, {}),
    "more bounces": ({"max_depth": 8}, {}),
    "fewer bounces": ({"max_depth": 3}, {}),
    "roulette at once": ({"rr_depth": 1}, {}),
    "another stride": ({"adjoint": rb.MemoizedAdjoint(2)}, {}),
    "bisection": ({"adjoint": rb.MemoizedAdjoint("log", keep_hits=False)}, {}),
    "brute force": ({"caster": "brute"}, {}),
}


@pytest.mark.parametrize("settings, call", VARIATIONS.values(), ids=VARIATIONS)
def test_nothing_is_compiled_again_for(compiled, settings, call):
    before = functions()
    assert before >= 3  # camera, bounce, adjoint of a bounce
    renderer = make(compile=True, **settings)
    image, gradients = view_and_gradients(renderer, **call)
    assert_informative(image, list(gradients))
    assert functions() == before


def test_nothing_is_compiled_again_over_iterations_of_an_optimisation(compiled):
    renderer = make(compile=True)
    wanted = [renderer.scene.get_parameter(name) for name in NAMES]
    optimizer, before = torch.optim.Adam(wanted, lr=0.01), functions()
    first = [parameter.detach().clone() for parameter in wanted]
    for seed in range(3):
        optimizer.zero_grad()
        (renderer(seed=seed, seed_grad=seed + 10) - 0.2).square().mean().backward()
        optimizer.step()
    assert functions() == before
    assert all((parameter - start).abs().max() > 1e-3 for parameter, start in zip(wanted, first))


@pytest.mark.filterwarnings("default:.*runs eagerly:RuntimeWarning")
def test_a_stage_that_cannot_be_compiled_runs_eagerly_and_says_so_once():
    stage, x = stages.CompiledStage(lambda x: x.sort()[0], ()), torch.tensor([2.0, 1.0, 3.0])
    with pytest.warns(RuntimeWarning, match="runs eagerly, which is slower: .*sort") as said:
        for _ in range(3):
            assert stage(x).tolist() == [1, 2, 3]
    assert len(said) == 1


def test_plain_autograd_records_an_eager_rendering():
    results = [image_and_gradients(cornell(torch.float64, 4), NAMES, compile=compile, adjoint=rb.TapeAdjoint(), seed=8,
                                   **SETTINGS) for compile in (False, True)]
    (expected, gradients), (image, found) = results
    assert_informative(expected, list(gradients))
    assert torch.equal(image, expected) and all(torch.equal(a, b) for a, b in zip(found, gradients))
