"""Roughness at its floor of 1e-4: the value stays there, the derivative leads out again."""

import pytest
import torch

import torch_radbp as rb
from tests.deep import deep
from tests.scenes import rectangle, sensor
from torch_radbp.bsdf.microfacet import SMALLEST_ALPHA, microfacets
from torch_radbp.tensors.vec import Vec3


def direction(x: float, y: float) -> Vec3:
    return Vec3(*torch.tensor([[x], [y], [(1 - x * x - y * y) ** 0.5]], dtype=torch.float64))


U, V = torch.tensor([[0.3], [0.6]], dtype=torch.float64)
QUANTITIES = {
    "density": lambda facets: facets.density(direction(2e-5, -4e-5)),
    "projected area": lambda facets: facets.projected_area(direction(0.6, 0.8 - 1e-9)),
    "masking": lambda facets: facets.masking(direction(0.7, 0.3)),
    "sample": lambda facets: facets.sample_visible(direction(0.6, 0.3), U, V).x,
}


def value_and_derivative(quantity: str, distribution: str, alpha: float) -> tuple[float, float]:
    alpha = torch.tensor([alpha], dtype=torch.float64, requires_grad=True)
    value = QUANTITIES[quantity](microfacets(distribution, alpha, alpha))
    gradient, = torch.autograd.grad(value.sum(), alpha)
    return value.item(), gradient.item()


@pytest.mark.parametrize("distribution", ["ggx", "beckmann"])
@pytest.mark.parametrize("quantity", QUANTITIES)
@pytest.mark.parametrize("alpha", [0.0, 1e-9, 0.99e-4])
def test_below_the_floor_values_and_derivatives_are_those_at_the_floor(quantity, distribution, alpha):
    value, derivative = value_and_derivative(quantity, distribution, SMALLEST_ALPHA)
    assert value_and_derivative(quantity, distribution, alpha) == pytest.approx((value, derivative), rel=1e-9)
    if (quantity, distribution) != ("masking", "beckmann"):  # which is exactly 1 / cos where the surface is nearly flat
        assert derivative != 0


def plate(distribution: str, alpha: float, kind: str = "roughconductor") -> rb.Scene:
    """A plate in which the camera sees the brightest point of the sky, in float64: any roughness makes it darker."""
    bsdf = {"type": kind, "distribution": distribution, "alpha": alpha}
    sky = torch.full((5, 7), 0.1)
    sky[2, 3] = 10.0
    return rb.load_dict({"type": "scene", "sensor": sensor(1, fov=0.1), "plate": rectangle((0, 0, 0), bsdf=bsdf),
                         "sky": {"type": "envmap", "bitmap": sky}}).double()


@pytest.mark.parametrize("distribution, kind", [("ggx", "roughconductor"), ("beckmann", "roughdielectric"),
                                                deep("ggx", "roughdielectric"), deep("beckmann", "roughconductor")])
def test_roughness_that_was_clamped_to_zero_comes_back(distribution, kind):
    settings = {"spp": 256, "max_depth": 3, "sampling": "attached"}
    target = rb.render(plate(distribution, 0.2, kind), seed=100, **settings)
    scene = plate(distribution, 0.02, kind)
    alpha = scene.get_parameter("plate.bsdf.alpha.value").requires_grad_()
    alpha.data.sub_(0.5).clamp_(0, 1)
    assert alpha == 0
    renderer, optimizer = rb.Renderer(scene, **settings), torch.optim.Adam([alpha], lr=0.03)
    for step in range(12):
        optimizer.zero_grad()
        (renderer(seed=step) - target).square().mean().backward()
        assert alpha.grad != 0
        optimizer.step()
        alpha.data.clamp_(0, 1)
    assert 0.1 < alpha < 0.4


@pytest.mark.parametrize("distribution", ["ggx", "beckmann"])
def test_forward_and_backward_mode_agree_at_the_floor(distribution):
    scene = plate(distribution, 0.0)
    settings = {"spp": 8, "max_depth": 3, "sampling": "attached"}
    alpha = scene.get_parameter("plate.bsdf.alpha.value").requires_grad_()
    w = torch.tensor([1.0, -2.0, 3.0], dtype=torch.float64).reshape(1, 3, 1, 1)
    gradient, = torch.autograd.grad((rb.render(scene, seed=3, **settings) * w).sum(), alpha)
    alpha.requires_grad_(False)
    tangent = rb.jvp(scene, {"plate.bsdf.alpha.value": torch.ones(())}, seed=3, **settings)
    assert gradient != 0
    torch.testing.assert_close((tangent * w).sum(), gradient, rtol=1e-8, atol=0.0)
