"""Products with J and its transpose against the tape, their bias, and closed forms of linear problems."""

import math

import pytest
import torch
from torch.nn.utils import parametrize

import torch_radbp as rb
from tests.scenes import cornell, load, overhead, rectangle, rgb, texels
from tests.scenes.sunlit import COLOUR, SUN, wall_under_sun
from torch_radbp.optim.linearisation import Linearisation

NAMES = ["white.reflectance.value", "light.emitter.radiance.value"]


def room() -> rb.Renderer:
    return rb.Renderer(cornell(torch.float64, 4), spp=8, max_depth=4)


def taped(renderer: rb.Renderer, names: list[str], seed: int) -> torch.Tensor:
    """J, (M, n), row by row, by autograd's own tape."""
    tape = rb.Renderer(renderer.scene, spp=renderer.spp, max_depth=renderer.max_depth, adjoint=rb.TapeAdjoint())
    held = [tape.scene.get_parameter(name).requires_grad_() for name in names]
    rows = [torch.cat([part.reshape(-1) for part in torch.autograd.grad(value, held, retain_graph=True)])
            for value in tape(seed=seed).reshape(-1)]
    return torch.stack(rows)


def test_products_are_those_of_the_tape():
    renderer = room()
    curvature = rb.curvature(renderer, NAMES, noise=0.1, seed=5)
    a, b = (taped(renderer, NAMES, seed) for seed in (5, 6))
    assert a.isfinite().all() and a.abs().max() > 0.1
    direction = torch.tensor([0.3, -1.1, 0.7, 0.2, -0.05, 0.4], dtype=torch.float64)
    same, other = (curvature.product(direction, 1, independent=choice).value for choice in (False, True))
    for found, expected in ((same, a.T @ a @ direction / 0.01), (other, b.T @ a @ direction / 0.01)):
        assert (found - expected).norm() <= 1e-10 * expected.norm()
    symmetric = (a.T @ b + b.T @ a) / 0.02
    operator = curvature.linear_operator()
    columns = torch.from_numpy(operator @ torch.eye(6, dtype=torch.float64).numpy())
    assert (columns - symmetric).norm() <= 1e-10 * symmetric.norm()
    dense = curvature.dense(2)
    assert (dense.matrix - symmetric).norm() <= 1e-10 * symmetric.norm()


def test_independent_seeds_have_no_bias_and_one_seed_has():
    """Both against many samples: the mean over pairs within 4.5 standard errors, that of one seed far above."""
    renderer = rb.Renderer(cornell(torch.float64, 4), spp=1, max_depth=3)
    exact = rb.curvature(renderer, NAMES[:1], spp=1024, seed=99).dense(3).matrix
    direction = torch.ones(3, dtype=torch.float64)
    expected = exact @ direction
    curvature = rb.curvature(renderer, NAMES[:1])
    found = curvature.product(direction, 48)
    assert found.error.isfinite().all() and (found.error > 0).all()
    assert ((found.value - expected).abs() <= 4.5 * found.error).all()
    biased = curvature.product(direction, 48, independent=False)
    assert (biased.value - expected > 4.5 * biased.error).any()


def test_closed_form_of_reflectance_and_irradiance():
    """L = reflectance irradiance / pi in each of 16 pixels and 3 colours."""
    renderer = rb.Renderer(wall_under_sun(), spp=2, max_depth=2)
    matrix, error, _ = rb.curvature(renderer, [COLOUR, SUN], noise=0.05).dense(3)
    colour, sun = (renderer.scene.get_parameter(name).detach() for name in (COLOUR, SUN))
    expected = torch.cat([torch.cat([(sun * sun).diag(), (sun * colour).diag()], 1),
                          torch.cat([(sun * colour).diag(), (colour * colour).diag()], 1)]) * 16 / math.pi ** 2 / 0.05 ** 2
    assert (matrix - expected).abs().max() <= 1e-6 * expected.max()
    assert error.max() <= 1e-6 * expected.max()


def test_masked_pixels_do_not_count():
    renderer = rb.Renderer(wall_under_sun(), spp=2, max_depth=2)
    noise = torch.full((1, 3, 4, 4), 0.05)
    noise[..., 2:] = math.inf
    half, whole = (rb.curvature(renderer, COLOUR, noise=each).dense(2).matrix for each in (noise, 0.05))
    assert whole.trace() > 1
    assert (half - whole / 2).abs().max() <= 1e-6 * whole.max()


def test_parametrisations_and_functions_of_images():
    """d exp(u) = exp(u) du, and the gain of an exposure beside it: image g x / pi E."""
    scene = wall_under_sun()
    parametrize.register_parametrization(scene.sun.irradiance, "value", rb.optim.Log())
    logarithm = scene.sun.irradiance.parametrizations.value.original
    gain = torch.tensor(1.5, dtype=torch.float64, requires_grad=True)
    renderer = rb.Renderer(scene, spp=2, max_depth=2)
    linear = Linearisation(lambda seed, spp: [gain * renderer(seed=seed, spp=spp), gain.square()], [logarithm, gain])
    jacobian, image = linear.jacobian(3, 2), renderer(seed=3).detach().reshape(-1)
    assert image.abs().min() > 0.1
    assert torch.allclose(jacobian[:-1, 3], image, rtol=1e-10, atol=0)
    assert torch.allclose(jacobian[:-1, :3].sum(1), 1.5 * image, rtol=1e-10, atol=0)
    assert jacobian[-1].tolist() == [0, 0, 0, 3.0]
    transposed = linear.backward(jacobian.sum(1), 3, 2)
    assert torch.allclose(transposed, jacobian.T @ jacobian.sum(1), rtol=1e-10, atol=0)
    assert gain.requires_grad and gain.grad is None and float(gain.detach()) == 1.5


def test_what_is_asked_wrongly_is_said():
    renderer = rb.Renderer(wall_under_sun(), spp=2, max_depth=2)
    with pytest.raises(ValueError, match="must be positive, got 0"):
        rb.curvature(renderer, COLOUR, noise=0.0)
    with pytest.raises(AttributeError, match="wall.bsdf.reflectance.value"):
        rb.curvature(renderer, "wall.bsdf.reflectanc.value")
    with pytest.raises(TypeError, match="map names to tensors"):
        rb.curvature(lambda seed, spp: renderer(seed=seed), [COLOUR])
    with pytest.raises(ValueError, match="as many entries as the images, 48, got 5"):
        rb.curvature(renderer, COLOUR, noise=torch.ones(5)).dense(2)
    with pytest.raises(ValueError, match="at least 2"):
        rb.curvature(renderer, COLOUR).dense(1)
    parametrize.register_parametrization(renderer.scene.sun.irradiance, "value", rb.optim.Log())
    with pytest.raises(AttributeError, match=r"sun.irradiance.parametrizations.value.original"):
        rb.curvature(renderer, SUN)


def test_the_diagonal_by_probing_is_that_of_the_matrix():
    """A wall of texels each of which a pixel of its own sees: nothing lies beside the diagonal, and one probe is exact."""
    texture = {"type": "bitmap", "data": texels(4, 4), "raw": True, "filter_type": "nearest"}
    scene = load(sensor=overhead(4, half=1), wall=rectangle((0, 0, 0), 1, bsdf={"type": "diffuse", "reflectance": texture}),
                 sun={"type": "directional", "direction": [0, 0, -1], "irradiance": rgb(2, 2, 2)})
    renderer, name = rb.Renderer(scene, spp=4, max_depth=2), "wall.bsdf.reflectance.data"
    exact, probed = rb.curvature(renderer, name).dense(2).matrix.diag(), rb.curvature(renderer, name).diagonal(2)
    assert torch.allclose(exact, torch.full_like(exact, (2 / math.pi) ** 2), rtol=1e-6)
    assert torch.allclose(probed.value, exact, rtol=1e-6)


def test_sensitivity_is_where_a_parameter_is_seen():
    renderer = rb.Renderer(wall_under_sun(), spp=2, max_depth=2)
    images = rb.sensitivity(renderer, COLOUR)
    assert list(images) == [f"{COLOUR}[{channel}]" for channel in range(3)]
    assert torch.allclose(images[f"{COLOUR}[1]"][0, 1], torch.full((4, 4), 3 / math.pi, dtype=torch.float64), rtol=1e-6)
    assert images[f"{COLOUR}[1]"][0, [0, 2]].abs().max() == 0


def test_jacobians_that_memory_does_not_hold_are_refused(monkeypatch):
    monkeypatch.setattr("torch_radbp.uncertainty.curvature.memory_of", lambda device: 1000.0)
    with pytest.raises(MemoryError, match="2 Jacobians of 48 by 3 numbers take .* take fewer repeats"):
        rb.curvature(rb.Renderer(wall_under_sun(), spp=2, max_depth=2), COLOUR).dense(2)
