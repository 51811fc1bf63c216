"""Fresnel's equations against closed forms and complex arithmetic (Born and Wolf 1999, sections 1.5 and 14.2)."""

import math

import numpy as np
import pytest
import torch

from torch_radbp.bsdf.fresnel import conductor_reflectance, dielectric_reflectance
from torch_radbp.tensors.vec import Vec3

ANGLES = torch.linspace(0.0, math.pi / 2 - 1e-3, 200, dtype=torch.float64)


def by_complex_numbers(cos_i: np.ndarray, index: complex) -> np.ndarray:
    """Mean of |rs|^2 and |rp|^2, with Snell's law in complex numbers."""
    cos_t = np.sqrt(1 - (1 - cos_i**2) / index**2 + 0j)
    rs = (cos_i - index * cos_t) / (cos_i + index * cos_t)
    rp = (index * cos_i - cos_t) / (index * cos_i + cos_t)
    return 0.5 * (abs(rs)**2 + abs(rp)**2)


def conductor(cos_i, eta, k):
    channel = torch.full_like(cos_i, eta), torch.full_like(cos_i, k)
    return conductor_reflectance(cos_i, *(Vec3(c, c, c) for c in channel)).x


@pytest.mark.parametrize("eta", [0.4, 0.75, 0.999, 1.001, 1.5, 2.4])
def test_dielectrics_match_complex_arithmetic(eta):
    cos_i = torch.cos(ANGLES)
    reflectance, cos_t = dielectric_reflectance(cos_i, torch.full_like(cos_i, eta))
    np.testing.assert_allclose(reflectance, by_complex_numbers(cos_i.numpy(), eta), atol=1e-6)
    total = torch.sin(ANGLES) > eta
    assert (reflectance[total] == 1).all() and (cos_t[total] == 0).all()
    torch.testing.assert_close(torch.sqrt(1 - cos_t**2)[~total] * eta, torch.sin(ANGLES)[~total], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("eta, k", [(0.2, 3.9), (1.5, 0.0), (4.4, 5.2), (0.05, 0.05), (2.0, 1e-6), (0.0, 2.0)])
def test_conductors_match_complex_arithmetic(eta, k):
    cos_i = torch.cos(ANGLES)
    np.testing.assert_allclose(conductor(cos_i, eta, k), by_complex_numbers(cos_i.numpy(), eta + 1j * k), atol=1e-9)


def test_normal_incidence_and_brewster():
    one = torch.ones(1, dtype=torch.float64)
    assert dielectric_reflectance(one, 1.5 * one)[0].item() == pytest.approx(0.04, abs=1e-12)
    assert conductor(one, 0.2, 3.9).item() == pytest.approx((0.8**2 + 3.9**2) / (1.2**2 + 3.9**2), abs=1e-10)
    # At Brewster's angle only perpendicular light is reflected: R = (cos^2 i - sin^2 i)^2 / 2.
    angle = torch.atan(1.5 * one)
    expected = 0.5 * torch.cos(2 * angle)**2
    assert dielectric_reflectance(torch.cos(angle), 1.5 * one)[0].item() == pytest.approx(expected.item(), abs=1e-12)


def test_equal_indices_reflect_nothing_and_a_perfect_mirror_everything():
    cos_i = torch.cos(ANGLES)
    assert dielectric_reflectance(cos_i, torch.ones_like(cos_i))[0].abs().max() < 1e-12
    assert (conductor(cos_i, 0.0, 1.0) - 1).abs().max() < 1e-12


@pytest.mark.parametrize("eta, k", [(0.0, 1e6), (0.0, 1e9), (1e-3, 1e9), (1e9, 0.0), (1e9, 1e9)])
def test_huge_indices_reflect_nearly_everything_in_float32(eta, k):
    """Reflectance differs from 1 by less than 4 / |index|, and larger indices than 1e6 count as that."""
    cos_i = torch.cos(ANGLES[:150]).float()
    assert (conductor(cos_i, eta, k) - 1).abs().max() < 1e-5


@pytest.mark.parametrize("eta, k", [(0.0, 0.0), (1.0, 0.0), (1e-8, 1e-8), (0.2, 3.9), (1.5, 0.0)])
def test_reflectances_and_their_derivatives_are_finite_in_float32_up_to_grazing(eta, k):
    cos_i = torch.cat([torch.zeros(1), torch.logspace(-12, 0, 100)]).requires_grad_()
    index = [torch.full_like(cos_i, value).requires_grad_() for value in (eta, k)]
    reflectance = conductor_reflectance(cos_i, *(Vec3(value, value, value) for value in index)).x
    rounding = 1e-6  # of a difference that vanishes where the index is 1
    assert (reflectance > -rounding).all() and (reflectance < 1 + rounding).all()
    slopes = torch.autograd.grad(reflectance.sum(), [cos_i, *index])
    assert all(slope.isfinite().all() for slope in slopes)


def test_a_perfect_mirror_has_the_derivative_that_differences_show():
    """eta = 0 is where the textbook's root has no derivative, and the default of Mitsuba's conductor."""
    eta = torch.zeros(1, dtype=torch.float64, requires_grad=True)
    cos_i = torch.tensor([0.6], dtype=torch.float64)
    index = Vec3(eta, eta, eta), Vec3.full(cos_i, 1.0)
    slope, = torch.autograd.grad(conductor_reflectance(cos_i, *index).x, eta)
    difference = (by_complex_numbers(cos_i.numpy(), 1e-6 + 1j) - 1) / 1e-6
    assert slope.item() == pytest.approx(difference.item(), rel=1e-4) and slope.item() < -0.5
