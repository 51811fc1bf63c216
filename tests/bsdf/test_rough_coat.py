"""What a rough coat reflects back inside, R: closed forms, Mitsuba's sum, and slopes without ripples; what it lets through,
T: its slopes are those of a finer quadrature.
"""

import pytest
import torch

from torch_radbp.bsdf.fresnel import dielectric_reflectance
from torch_radbp.bsdf.microfacet import microfacets
from torch_radbp.bsdf.rough_coat import abscissa, coat_of, escaping
from torch_radbp.tensors.vec import Vec3, dot

CASES = [("beckmann", 0.1, 1.49), ("beckmann", 0.7, 1.67), ("beckmann", 0.3, 0.7), ("ggx", 0.03, 1.9), ("ggx", 0.2, 1.966),
         ("ggx", 0.5, 0.75), ("ggx", 1.0, 1.3)]
STEP = 0.01  # relative, of central differences


def mitsubas_sum(distribution: str, alpha: float, eta: float, nodes: int = 100) -> float:
    """2/64 times the sum of z M(z) over 64 cosines z from 0 to 1, M by the midpoint rule over visible microfacets."""
    z = torch.linspace(0.0, 1.0, 64, dtype=torch.float64).clamp_min(1e-6)[:, None, None]
    numbers = (torch.arange(nodes, dtype=torch.float64) + 0.5) / nodes
    u, v = numbers[:, None], numbers[None, :]
    z, u, v = (number.reshape(-1) for number in torch.broadcast_tensors(z, u, v))
    facets = microfacets(distribution, *2 * [torch.full_like(z, alpha)])
    w = Vec3(torch.sqrt(1.0 - z * z), torch.zeros_like(z), z)
    m = facets.sample_visible(w, u, v)
    cosine = dot(w, m).clamp_min(1e-9)
    out = m * (2.0 * cosine) - w
    escapes = facets.masking(out._replace(z=out.z.abs())) * out.z.clamp_min(0.0)
    return float((dielectric_reflectance(cosine, torch.full_like(z, 1.0 / eta))[0] * escapes * z).mean() * 2.0)


@pytest.mark.parametrize("distribution, alpha, eta", CASES)
def test_the_light_that_is_reflected_inside_is_mitsubas_sum(distribution, alpha, eta):
    expected = mitsubas_sum(distribution, alpha, eta)
    assert 0.01 < expected < 0.9
    assert float(coat_of(distribution, alpha, eta).numbers[0]) == pytest.approx(expected, rel=1e-3, abs=1e-4)


@pytest.mark.parametrize("distribution", ["beckmann", "ggx"])
@pytest.mark.parametrize("eta", [1.2, 1.5, 2.4])
def test_a_smooth_coat_reflects_back_what_fresnels_equations_say(distribution, eta):
    """R of a boundary seen from inside is 1 - (1 - R from outside) / eta^2, by reciprocity."""
    z, weight = (torch.linspace(0.5 / 4000, 1 - 0.5 / 4000, 4000, dtype=torch.float64), 1 / 4000)
    index = torch.full_like(z, eta)
    outside = float((2.0 * z * dielectric_reflectance(z, index)[0]).sum() * weight)
    inside = 1.0 - (1.0 - outside) / eta**2
    upright = ((eta - 1.0) / (eta + 1.0)) ** 2
    assert float(coat_of(distribution, 0.0, eta).numbers[0]) == pytest.approx((63 * inside + upright) / 64, rel=1e-4)


@pytest.mark.parametrize("distribution, alpha, eta", CASES)
def test_its_slopes_are_those_of_differences(distribution, alpha, eta):
    """Over steps of 1%: a sum over fixed microfacets ripples by 12% as the critical angle passes them."""
    coat = coat_of(distribution, alpha, eta)

    def number(factor_alpha: float, factor_eta: float) -> float:
        return float(coat_of(distribution, alpha * factor_alpha, eta * factor_eta).numbers[0])

    by_alpha = (number(1 + STEP, 1) - number(1 - STEP, 1)) / (2 * STEP * alpha)
    by_eta = (number(1, 1 + STEP) - number(1, 1 - STEP)) / (2 * STEP * eta)
    assert abs(by_alpha) > 1e-2 and abs(by_eta) > 1e-2
    assert float(coat.by_alpha[0]) == pytest.approx(by_alpha, rel=0.01)
    assert float(coat.by_eta[0]) == pytest.approx(by_eta, rel=2e-3)


def fine_transmission(distribution: str, alpha: float, eta: float, z: torch.Tensor, nodes: int = 250) -> torch.Tensor:
    """(M,) T of some cosines by the midpoint rule over visible microfacets, unrounded."""
    numbers = (torch.arange(nodes, dtype=torch.float64) + 0.5) / nodes
    w_z, u, v = (number.reshape(-1) for number in torch.broadcast_tensors(
        z[:, None, None], numbers[:, None], numbers[None, :]))
    facets = microfacets(distribution, *2 * [torch.full_like(u, alpha)])
    m = facets.sample_visible(Vec3(torch.sqrt(1.0 - w_z * w_z), torch.zeros_like(u), w_z), u, v)
    cosine = (torch.sqrt(1.0 - w_z * w_z) * m.x + w_z * m.z).clamp_min(1e-9)
    reflectance, cos_t = dielectric_reflectance(cosine, torch.full_like(u, eta))
    passing = (1.0 - reflectance) * escaping(facets, w_z / eta - m.z * (cosine / eta - cos_t))
    return passing.reshape(len(z), -1).mean(1)


@pytest.mark.parametrize("distribution, alpha, eta", [("beckmann", 0.3, 1.49), ("ggx", 0.3, 1.49), ("ggx", 0.2, 1.9)])
def test_what_it_lets_through_has_the_slopes_of_a_finer_quadrature(distribution, alpha, eta):
    """Where derivatives of roughplastic are not Mitsuba's, see tests/peer/test_derivatives_agree.py, ours are right."""
    z = torch.tensor([0.05, 0.1, 0.3, 0.6, 0.95], dtype=torch.float64)

    def of_polynomial(alpha: torch.Tensor, eta: torch.Tensor) -> torch.Tensor:
        coat = coat_of(distribution, float(alpha.detach()), float(eta.detach()))
        numbers = coat.numbers + coat.by_alpha * (alpha - alpha.detach()) + coat.by_eta * (eta - eta.detach())
        order = torch.arange(len(numbers) - 1, dtype=torch.float64)
        return torch.cos(torch.arccos(abscissa(z, alpha, eta))[:, None] * order) @ numbers[1:]

    at = torch.tensor([alpha, eta], dtype=torch.float64)
    slopes = torch.func.jacrev(lambda both: of_polynomial(*both))(at)
    expected = [(fine_transmission(distribution, alpha + h, eta + k, z) - fine_transmission(
        distribution, alpha - h, eta - k, z)) / 2e-3 for h, k in ((1e-3, 0.0), (0.0, 1e-3))]
    for found, wanted in zip(slopes.unbind(1), expected):
        assert wanted.abs().max() > 0.1
        torch.testing.assert_close(found, wanted, rtol=0, atol=3e-3 * float(wanted.abs().max()))
