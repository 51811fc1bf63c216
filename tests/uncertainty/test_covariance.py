"""Covariances: closed forms, refits from noisy images, and what cannot be told."""

import math

import pytest
import torch
from torch.nn.utils import parametrize

import torch_radbp as rb
from tests.scenes import diffuse, load, look_at, overhead, rectangle, rgb
from tests.scenes.sunlit import COLOUR, SUN, wall_under_sun

pytestmark = pytest.mark.filterwarnings("ignore::torch_radbp.ZeroGradientWarning")


def renderer_of(scene: rb.Scene) -> rb.Renderer:
    return rb.Renderer(scene, spp=2, max_depth=2)


def test_closed_form_of_a_reflectance():
    """Its variance is sigma^2 pi^2 / (M E^2) of M pixels."""
    renderer = renderer_of(wall_under_sun())
    found = rb.covariance(renderer, renderer(seed=0).detach(), COLOUR, noise=0.05)
    expected = 0.05 * math.pi / (4 * torch.tensor([2.0, 3.0, 4.0], dtype=torch.float64))
    assert torch.allclose(found.standard_deviations[COLOUR], expected, rtol=1e-6, atol=0)
    assert torch.allclose(found.correlations, torch.eye(3, dtype=torch.float64), atol=1e-6)
    assert not found.flat and not found.weak


def test_noise_from_residuals_is_that_of_the_images():
    renderer = renderer_of(wall_under_sun(16))
    exact = renderer(seed=0).detach()
    target = exact + 0.05 * torch.randn(exact.shape, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    assert rb.covariance(renderer, target, COLOUR).noise == pytest.approx(0.05, rel=4 / (2 * exact.numel()) ** 0.5)
    with pytest.raises(ValueError, match="equal, bit by bit"):
        rb.covariance(renderer, renderer(seed=0).detach(), COLOUR)


def test_reflectance_and_light_are_known_as_a_product_only():
    renderer = renderer_of(wall_under_sun())
    target, names = renderer(seed=0).detach(), [COLOUR, SUN]
    found = rb.covariance(renderer, target, names, noise=0.05)
    assert sorted(direction.words for direction in found.flat) == [
        f"{COLOUR}[{channel}] and {SUN}[{channel}] only as a product" for channel in range(3)]
    assert all(bool(deviation.isinf().all()) for deviation in found.standard_deviations.values())
    assert "not told: " in str(found) and "only as a product" in str(found)
    scene = renderer.scene
    product = found.propagated(lambda: scene.get_parameter(COLOUR) * scene.get_parameter(SUN))
    assert torch.allclose(product, torch.full_like(product, 0.05 * math.pi / 4), rtol=1e-5, atol=0)
    assert found.propagated(lambda: scene.get_parameter(COLOUR) + 0.0).isinf().all()


def test_a_prior_tells_what_images_do_not():
    """Of one colour: precisions E^2 M / (pi sigma)^2 of images and the prior's add up, by the formula of two by two."""
    renderer = renderer_of(wall_under_sun())
    found = rb.covariance(renderer, renderer(seed=0).detach(), [COLOUR, SUN], noise=0.05, prior={SUN: 0.1})
    assert not found.flat
    colour, sun = torch.tensor([0.3, 0.5, 0.7]).double(), torch.tensor([2.0, 3.0, 4.0]).double()
    product = 0.05 * math.pi / 4
    assert torch.allclose(found.standard_deviations[SUN], torch.full((3,), 0.1).double(), rtol=1e-5)
    expected = ((product / sun).square() + (colour / sun * 0.1).square()).sqrt()
    assert torch.allclose(found.standard_deviations[COLOUR], expected, rtol=1e-5)
    assert (found.correlations[0, 3] < 0) and (found.correlations.diag() - 1).abs().max() < 1e-9


def test_what_nothing_sees_is_said():
    scene = load(sensor=overhead(4), wall=rectangle((0, 0, 0), 3, bsdf=diffuse(0.3, 0.5, 0.7)),
                 behind=rectangle((0, 0, 9), 1, bsdf=diffuse(0.5, 0.5, 0.5)),
                 sun={"type": "point", "position": [0, 0, 2], "intensity": rgb(2, 3, 4)})
    renderer, unseen = renderer_of(scene), "behind.bsdf.reflectance.value"
    found = rb.covariance(renderer, renderer(seed=0).detach(), [COLOUR, unseen], noise=0.05)
    assert sorted(direction.words for direction in found.flat) == [
        f"{unseen}[{channel}] is not seen at all" for channel in range(3)]
    assert found.standard_deviations[COLOUR].isfinite().all() and found.standard_deviations[unseen].isinf().all()


def test_a_parametrised_value_by_propagation():
    scene = wall_under_sun()
    parametrize.register_parametrization(scene.wall.bsdf.reflectance, "value", rb.optim.Sigmoid())
    renderer, u = renderer_of(scene), scene.wall.bsdf.reflectance.parametrizations.value.original
    found = rb.covariance(renderer, renderer(seed=0).detach(), {"u": u}, noise=0.05)
    expected = 0.05 * math.pi / (4 * torch.tensor([2.0, 3.0, 4.0], dtype=torch.float64))
    assert torch.allclose(found.propagated(lambda: scene.wall.bsdf.reflectance.value), expected, rtol=1e-5, atol=0)


def test_many_parameters_by_probing():
    """Texels with a pixel each: the variance is 1 / (precision of the pixel + that of the prior)."""
    texture = {"type": "bitmap", "data": torch.full((4, 4, 3), 0.5).numpy(), "raw": True, "filter_type": "nearest"}
    scene = load(sensor=overhead(4, half=1), wall=rectangle((0, 0, 0), 1, bsdf={"type": "diffuse", "reflectance": texture}),
                 sun={"type": "directional", "direction": [0, 0, -1], "irradiance": rgb(2, 2, 2)})
    name = "wall.bsdf.reflectance.data"
    found = rb.diagonal_covariance(renderer_of(scene), name, noise=0.1, prior={name: 0.2}, probes=4)
    expected = ((2 / math.pi / 0.1) ** 2 + 1 / 0.2 ** 2) ** -0.5
    assert torch.allclose(found.standard_deviations[name], torch.full((4, 4, 3), expected, dtype=torch.float64), rtol=1e-5)
    with pytest.raises(ValueError, match="finite prior of every parameter"):
        rb.diagonal_covariance(renderer_of(scene), name, noise=0.1, prior={})


def test_many_correlated_parameters_by_probing():
    """Blurred numbers, of which some are known to half of the prior, and some hardly: against the inverse of the matrix."""
    places = torch.arange(240, dtype=torch.float64) / 3
    blur = torch.stack([torch.exp(-((places - at) / (0.5 + at / 10)).square()) for at in range(80)], 1)
    x = torch.zeros(80, dtype=torch.float64)
    found = rb.diagonal_covariance(lambda seed, spp: blur @ x, {"x": x}, noise=0.2, prior={"x": 0.3}, probes=128)
    exact = torch.linalg.inv(blur.T @ blur / 0.2 ** 2 + torch.eye(80) / 0.3 ** 2).diag().sqrt()
    assert exact.min() < 0.15 and exact.max() > 0.25
    deviation, error = found.standard_deviations["x"], found.error["x"]
    assert (deviation <= 0.3).all() and error.max() < 0.06 * 0.3
    assert ((deviation - exact).abs() <= 5 * error + 0.005).all()


@pytest.mark.parametrize(("prior", "message"), [({COLOUR: 0.0}, "leave it out"), ({"u": 1.0}, "none of the parameters")])
def test_priors_that_make_no_sense(prior, message):
    renderer = renderer_of(wall_under_sun())
    with pytest.raises(ValueError, match=message):
        rb.covariance(renderer, renderer(seed=0).detach(), COLOUR, noise=0.05, prior=prior)


def test_targets_of_another_shape_and_too_many_parameters():
    renderer, many = renderer_of(wall_under_sun()), torch.ones(300)
    with pytest.raises(ValueError, match="targets must have the shapes"):
        rb.covariance(renderer, torch.zeros(1, 3, 5, 4), COLOUR, noise=0.05)
    with pytest.raises(ValueError, match="up to 200"):
        rb.covariance(lambda seed, spp: many.view(1, 1, 1, -1), torch.zeros(1, 1, 1, 300), {"many": many}, noise=0.1)


def test_the_next_view_is_the_one_that_sees_what_is_unknown():
    """One camera sees the wall, one the floor behind it; the floor's colour is asked for."""
    scene = load(front=overhead(4), aside=overhead(4) | {"to_world": look_at((9, 0, 4), (9, 0, 0), (0, 1, 0))},
                 wall=rectangle((0, 0, 0), 3, bsdf=diffuse(0.3, 0.5, 0.7)),
                 floor=rectangle((9, 0, 0), 3, bsdf=diffuse(0.2, 0.4, 0.6)),
                 sun={"type": "directional", "direction": [0, 0, -1], "irradiance": rgb(2, 3, 4)})
    renderer, floor = renderer_of(scene), "floor.bsdf.reflectance.value"
    views = rb.next_view(renderer, ["front", "aside"], [floor], noise=0.05, prior={floor: 0.3})
    assert views.best == "aside" and views.before.left == views.ranking[1].left == pytest.approx(1)
    expected = ((4 * torch.tensor([2.0, 3.0, 4.0]).double() / math.pi / 0.05).square() + 1 / 0.09).rsqrt()
    assert torch.allclose(views.ranking[0].standard_deviations[floor], expected, rtol=1e-5)
    assert "aside" in str(views)
    with pytest.raises(ValueError, match="finite prior of every parameter"):
        rb.next_view(renderer, ["front"], [floor], noise=0.05, prior={})
    with pytest.raises(ValueError, match="got none"):
        rb.next_view(renderer, [], [floor], noise=0.05, prior={floor: 0.3})
