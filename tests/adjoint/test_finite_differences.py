"""The gradient against differences of the image itself: the tape, which is the oracle of the others, included.

Detached sampling of diffuse scenes makes directions, densities, weights and choices of lights independent of reflectance
and radiance. With roulette off an image at one seed is a smooth function of them (a polynomial), whose derivative is the
gradient: finite differences at one seed must agree to their own accuracy. With roulette only the expectations agree.
"""

import pytest
import torch
from torch.func import functional_call

import torch_radbp as rb
from tests.deep import deep, deep_but
from tests.gradients import assert_informative, image_and_gradients, relative_error
from tests.scenes import CASES, cornell, parameters

ADJOINTS = (rb.TapeAdjoint(), rb.MemoizedAdjoint(), rb.MemoizedAdjoint("log", keep_hits=False), rb.QuadraticAdjoint())


@pytest.mark.parametrize("name, adjoint", [
    *((name, rb.TapeAdjoint()) for name in ("cornell", "two_sided", "textured_lamp", "sky_and_points")),
    deep("mirror_bilinear", rb.TapeAdjoint()),
    *(("cornell", adjoint) for adjoint in ADJOINTS[1:])], ids=str)
def test_gradcheck(name, adjoint):
    case = CASES[name]
    scene = case.scene()
    for sensor in scene.sensors:
        sensor.film.width = sensor.film.height = sensor.film.crop_width = sensor.film.crop_height = 2
    renderer = rb.Renderer(scene, spp=1, max_depth=4, rr_depth=100, adjoint=adjoint, share_samples=True)
    inputs = [scene.get_parameter(n).detach().clone().requires_grad_() for n in case.parameters]
    names = [f"scene.{n}" for n in case.parameters]

    def image(*values):
        return functional_call(renderer, dict(zip(names, values)), kwargs={"seed": 5})

    assert_informative(image(*inputs).detach(), [])
    # Differences of a polynomial of degree 3 with h = 1e-6: by every entry of the Jacobian once, else by random directions.
    whole = name == "cornell" and isinstance(adjoint, rb.TapeAdjoint)
    assert torch.autograd.gradcheck(image, inputs, eps=1e-6, atol=1e-8, rtol=1e-6, fast_mode=not whole)


def polynomial_derivative_at_zero(image_at, degree: int) -> torch.Tensor:
    """The linear coefficient of a polynomial of `degree` from its values at as many points of [0, 1] as it takes."""
    nodes = torch.linspace(0, 1, degree + 1, dtype=torch.float64)
    values = torch.stack([image_at(float(x)).reshape(-1) for x in nodes])
    return torch.linalg.solve(torch.vander(nodes, increasing=True), values)[1]


def white_at(red: float, size: int = 6) -> rb.Scene:
    """The Cornell box with the red channel of `white` at a value."""
    scene = cornell(size=size)
    scene.get_parameter("white.reflectance.value").data[0] = red
    return scene


@pytest.mark.parametrize("adjoint", ADJOINTS, ids=repr)
def test_gradient_is_right_at_zero_reflectance(adjoint):
    depth, seed, cotangent = 6, 4, torch.ones(1, 3, 6, 6, dtype=torch.float64)
    settings = {"spp": 4, "max_depth": depth, "rr_depth": 100, "share_samples": True}
    _, (gradient,) = image_and_gradients(white_at(0.0), ["white.reflectance.value"], seed=seed, adj_image=cotangent,
                                         adjoint=adjoint, **settings)
    # Exact: at one seed the image is a polynomial of degree depth - 1 in one reflectance.
    expected = polynomial_derivative_at_zero(
        lambda red: rb.render(white_at(red), seed=seed, **settings), depth - 1).sum()
    assert expected > 1
    assert abs(gradient[0] - expected) < 1e-9 * expected  # conditioning of the fit, 1e4 roundings


def test_path_replay_misses_a_part_of_the_gradient_at_zero_reflectance():
    settings = {"seed": 4, "spp": 16, "max_depth": 6, "rr_depth": 100,
                "adj_image": torch.ones(1, 3, 6, 6, dtype=torch.float64)}
    _, (right,) = image_and_gradients(white_at(0.0), ["white.reflectance.value"], **settings)
    _, (replayed,) = image_and_gradients(white_at(0.0), ["white.reflectance.value"], adjoint=rb.ReplayAdjoint(), **settings)
    assert replayed[0] < 0.97 * right[0]
    assert relative_error(replayed[1:], right[1:]) < 1e-10


def directional(scene, names, direction, seeds, **settings):
    """The derivative of the mean image along `direction`, one number per seed, by the backward pass."""
    wanted = parameters(scene, names)
    renderer = rb.Renderer(scene, **settings)
    results = []
    for seed in seeds:
        gradients = torch.autograd.grad(renderer(seed=seed).mean(), wanted)
        results.append(sum((g * d).sum() for g, d in zip(gradients, direction)))
    return torch.stack(results)


def differences(scene, names, direction, seeds, step, **settings):
    """The same by central differences of images."""
    values = [scene.get_parameter(name) for name in names]
    start = [value.clone() for value in values]
    renderer = rb.Renderer(scene, **settings)

    def mean_image(distance, seed):
        for value, origin, d in zip(values, start, direction):
            value.data = origin + distance * d
        return renderer(seed=seed).mean()

    return torch.stack([(mean_image(step, seed) - mean_image(-step, seed)) / (2 * step) for seed in seeds])


def assert_same_mean(a, b, largest_error):
    """Welch's test: two independent sets of estimates have the same expectation, known to `largest_error` relative."""
    standard_error = (a.var() / len(a) + b.var() / len(b)).sqrt()
    assert torch.isfinite(b).all() and b.mean().abs() > 0
    assert standard_error < largest_error * b.mean().abs()
    assert (a.mean() - b.mean()).abs() < 4 * standard_error  # by chance about 2 times in 10,000; the seeds are fixed


@pytest.mark.parametrize("settings", [{"rr_depth": 100}, {"rr_depth": 1}, {"rr_depth": 2, "nee": False, "spp": 160},
                                      {"rr_depth": 1, "hide_emitters": True}], ids=str)
def test_expectation_agrees_with_independent_finite_differences(settings):
    names = CASES["cornell"].parameters
    generator = torch.Generator().manual_seed(1)
    direction = [torch.rand(3, generator=generator, dtype=torch.float64) for _ in names]
    settings = {"spp": 32, "max_depth": 4} | settings
    gradient = directional(cornell(size=6), names, direction, range(12), **settings)
    # Central differences of a cubic: the step changes the third order only, 1e-4 of the derivative.
    difference = differences(cornell(size=6), names, direction, range(100, 112), 0.02, **settings)
    assert_same_mean(gradient, difference, 0.1)


@pytest.mark.parametrize("rr_depth", deep_but([2], [1, 2]))
def test_roulette_keeps_the_gradient_right_at_zero_reflectance(rr_depth):
    """A path with throughput zero in a channel still has a derivative there: roulette must let some of them live."""
    names, settings = ["white.reflectance.value"], {"spp": 24, "max_depth": 5}
    direction = [torch.tensor([1.0, 0, 0], dtype=torch.float64)]

    scene = white_at(0.0)
    white = scene.get_parameter(names[0])
    white[1:] = 0  # nothing else keeps the path alive either
    with_roulette = directional(scene, names, direction, range(16), rr_depth=rr_depth, **settings)
    renderer = rb.Renderer(scene.requires_grad_(False), rr_depth=100, **settings)

    def mean_image(red: float, seed: int) -> torch.Tensor:
        white[0] = red
        return renderer(seed=seed).mean().reshape(1)

    without = torch.stack([polynomial_derivative_at_zero(lambda red, seed=seed: mean_image(red, seed), 4).sum()
                           for seed in range(100, 110)])
    assert_same_mean(with_roulette, without, 0.1)
