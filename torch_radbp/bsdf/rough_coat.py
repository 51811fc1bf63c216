"""The transmittance of a rough dielectric coat, and what it reflects back inside.

The fraction T(z) of the light that passes the coat from direction cosine z is, over the microfacets m that are visible,

    T = mean of (1 - F(w.m)) G1(refracted w),

a Gauss-Legendre sum in the random numbers that sample m. Of T a polynomial is made that interpolates it at Chebyshev points,
in

    sqrt(z + 0.001)                                          if the inside is denser: T is steep at grazing angles,
    the cosine of refraction, smoothed by the roughness      if the outside is: T has a shoulder at the critical angle.

At indices of 1.05 and more it is right to 0.002 for Beckmann and 0.008 for GGX, at smaller ones to 0.06, where its slopes
ripple by up to 10%, too: microfacets of the sum pass the critical angle.

The fraction R that the coat reflects back inside is, with F for the reciprocal index, D the density of microfacets, o the
direction that m reflects w to, and c = w.m,

    R = 2 times the integral of z M(z) dz,      M(z) = mean of F(c) G1(o) over visible m
      = 1/pi times the integral of F(c) c D(m) G1(w) G1(o) over all m and w
      = the integral of F(c) S(c) d(c^2),       S(c) = mean of G1(w) G1(o) / cos m over facets and azimuths of w about m,

in which S does not know the index. The slope of F is infinite at the critical angle; the integral over c is two sums, one on
each side of it, so that R has derivatives.

Mitsuba interpolates M and T linearly between 64 cosines, both ends included, and takes 2/64 times the sum of z M for R: but
for its discretisation, below 1e-3 if alpha is above 0.03, that is (63 R + M(1)) / 64, which is taken here.

Reference: Walter et al. 2007, "Microfacet Models for Refraction through Rough Surfaces".
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from torch_radbp.bsdf.fresnel import dielectric_reflectance, unpolarised
from torch_radbp.bsdf.microfacet import GGX, Beckmann, floored, microfacets
from torch_radbp.interface.bsdf import above
from torch_radbp.tensors.vec import Vec3, dot

TERMS = 11  # of the polynomial
SUMS = 1 + TERMS  # numbers that describe the coat: R, then the polynomial's coefficients
NODES = 32  # of the quadratures of T, along each random number
COSINES, FACETS, AZIMUTHS = 24, 48, 8  # nodes of the quadratures of R, on each side of the critical angle, and of S
UPRIGHT = 4096  # of the sum for M(1)
TABLE = 64  # cosines of Mitsuba's sum for R
OFFSET = 1e-3  # of the cosine under the root
SMALLEST_SQUARE = 1e-9  # of a smoothed cosine
ROUNDED = 2e-3  # squared cosines of refraction at which sums over microfacets at fixed angles round off the reflectance


def abscissa(z: Tensor, alpha: Tensor, eta: Tensor) -> Tensor:
    """The variable, in [-1, 1], of the polynomial for the coat's transmittance T at direction cosine `z`."""
    low, high = variable(torch.zeros_like(z), alpha, eta), variable(torch.ones_like(z), alpha, eta)
    return 2.0 * (variable(z, alpha, eta) - low) / (high - low).clamp_min(SMALLEST_SQUARE) - 1.0


def cosine_of(x: Tensor, alpha: Tensor, eta: Tensor) -> Tensor:
    """The direction cosine at which `abscissa` is `x`: its inverse."""
    low, high = variable(torch.zeros_like(x), alpha, eta), variable(torch.ones_like(x), alpha, eta)
    square = (low + (high - low) * (0.5 + 0.5 * x)).square()
    bend, shadow = smoothing(alpha, eta)
    cosine2 = square - bend * bend / (4.0 * square) + shadow
    return torch.where(eta >= 1.0, square - OFFSET, torch.sqrt(cosine2.clamp_min(SMALLEST_SQUARE)))


def variable(z: Tensor, alpha: Tensor, eta: Tensor) -> Tensor:
    """The variable of the polynomial for the coat's transmittance T, before it is mapped to [-1, 1]."""
    bend, shadow = smoothing(alpha, eta)
    cosine2 = z * z - shadow  # times eta^2: of refraction
    size = torch.sqrt(cosine2 * cosine2 + bend * bend)
    # (cosine2 + size) / 2 without cancellation.
    square = torch.where(cosine2 > 0, 0.5 * (cosine2 + size), 0.5 * bend * bend / (size + cosine2.abs()))
    return torch.sqrt(torch.where(eta >= 1.0, z + OFFSET, square.clamp_min(SMALLEST_SQUARE)))


def smoothing(alpha: Tensor, eta: Tensor) -> tuple[Tensor, Tensor]:
    """The smoothing of the squared cosine of refraction, and 1 - eta^2; without meaning if the inside is denser."""
    thin = eta.clamp_max(1.0)
    shadow = (1.0 - thin * thin).clamp_min(SMALLEST_SQUARE)
    return 2.0 * floored(alpha).clamp_max(1.0) * thin * torch.sqrt(shadow) + SMALLEST_SQUARE, shadow


class Coat(NamedTuple):
    """A tabulated coat: its reflectance R inside, its transmittance's coefficients, and derivatives; (SUMS,) float64."""

    numbers: Tensor
    by_alpha: Tensor
    by_eta: Tensor


@lru_cache(maxsize=128)
def coat_of(distribution: str, alpha: float, eta: float) -> Coat:
    """Tabulates the coat of a roughness and an index of refraction, by quadrature."""
    points = np.cos(math.pi * (np.arange(TERMS) + 0.5) / TERMS)
    fit = torch.from_numpy(np.polynomial.chebyshev.chebvander(points, TERMS - 1).T * (2.0 / TERMS))
    fit[0] *= 0.5

    def leaf(value: float, count: int) -> Tensor:
        return torch.full((count,), value, dtype=torch.float64, device="cpu", requires_grad=True)

    with torch.enable_grad():
        # Every sum depends on a leaf of its own, so that one sweep finds the derivatives of all.
        a, e = leaf(alpha, SUMS), leaf(eta, SUMS)
        cosines = cosine_of(torch.from_numpy(points), a[1:], e[1:])
        passing = refracted(distribution, a[1:], e[1:], cosines)
        sums = torch.cat([reflectance_inside(distribution, a[:1], e[:1]), passing])
        slopes = torch.autograd.grad(sums.sum(), (a, e))

    return Coat(*(torch.cat([part[:1], fit @ part[1:]]) for part in (sums.detach(), *slopes)))


def reflectance_inside(distribution: str, alpha: Tensor, eta: Tensor) -> Tensor:
    """The fraction of diffuse light inside that the coat reflects back, by Mitsuba's sum; attached.

    Args:
        alpha, eta: (1,) float64; eta is the index inside over the one outside.
    """
    x, weight = gauss_legendre(COSINES)
    y, weight = x * x, 4.0 * x**3 * weight  # of d(y^2), densest at grazing angles
    # Below the critical angle the cosine in the thinner medium, y, runs from 0 to 1, and the reflectance is smooth in it.
    thin = torch.minimum(eta, 1.0 / eta).square()
    denser = torch.sqrt(1.0 - thin * (1.0 - y * y))
    c, cos_t, range_ = (denser, y, thin) if eta > 1.0 else (y, denser, torch.ones_like(eta))
    returned = range_ * (unpolarised(c, cos_t, 1.0 / eta) * unshadowed(distribution, alpha, c) * weight).sum()
    if eta > 1.0:  # what is reflected totally
        returned = returned + (1.0 - thin) * (unshadowed(distribution, alpha, torch.sqrt(1.0 - thin) * y) * weight).sum()
    return ((TABLE - 1) * returned + reflectance_upright(distribution, alpha, eta)) / TABLE


def reflectance_upright(distribution: str, alpha: Tensor, eta: Tensor) -> Tensor:
    """(1,) the share M(1) of light at normal incidence that the coat reflects back inside, attached; arguments as above."""
    x = (torch.arange(UPRIGHT, dtype=torch.float64, device="cpu") + 0.5) / UPRIGHT
    facets = microfacets(distribution, alpha, alpha)
    m = facets.sample(1.0 - x * x, torch.zeros_like(x))
    reflectance, _ = rounded_reflectance(m.z, 1.0 / eta)
    return (2.0 * x * reflectance * escaping(facets, 2.0 * m.z * m.z - 1.0)).mean()


def unshadowed(distribution: str, alpha: Tensor, cosines: Tensor) -> Tensor:
    """(M,) the mean shadowing S of reflection by microfacets, over all orientations at given cosines of incidence; attached.

    Args:
        alpha: (1,) float64.
        cosines: (M,) greater than 0.
    """
    (x, facet_weight), (y, azimuth_weight) = gauss_legendre(FACETS), gauss_legendre(AZIMUTHS)
    facets = microfacets(distribution, alpha, alpha)
    # Densest where facets are steep.
    m, facet_weight = facets.sample(1.0 - x * x, torch.zeros_like(x)), 2.0 * x * facet_weight
    m, c = Vec3(*(part[:, None] for part in m)), cosines[:, None, None]
    # The direction and its reflection are that much above the surface, plus and minus what depends on the azimuth.
    middle, most = c * m.z, torch.sqrt((1.0 - c * c).clamp_min(SMALLEST_SQUARE)) * m.x
    azimuths = torch.asin((middle / most).clamp_max(1.0))  # up to which both are above it, of a quarter
    apart = most * torch.sin(azimuths * y)
    escape = escaping(facets, middle + apart) * escaping(facets, middle - apart)
    return (2.0 / math.pi) * torch.einsum("cfa,f,a->c", escape * azimuths / m.z, facet_weight, azimuth_weight)


def escaping(facets: Beckmann | GGX, z: Tensor) -> Tensor:
    """Smith's shadowing G1 of directions with cosine `z`; 0 below the surface."""
    w = above(Vec3(torch.sqrt((1.0 - z * z).clamp_min(SMALLEST_SQUARE)), torch.zeros_like(z), z))
    return facets.masking(w) * z.clamp_min(0.0)


def refracted(distribution: str, alpha: Tensor, eta: Tensor, cosines: Tensor) -> Tensor:
    """T, the fraction of light from given direction cosines that a rough boundary refracts; attached.

    Args:
        alpha, eta, cosines: (M,) float64; the index on the far side over that on the near side.
    """
    x, weight = gauss_legendre(NODES)
    u, v = (number.reshape(-1).repeat(len(cosines)) for number in torch.meshgrid(x, x, indexing="ij"))
    alpha, eta, z = (number.repeat_interleave(NODES * NODES) for number in (alpha, eta, cosines))
    w = Vec3(torch.sqrt((1.0 - z * z).clamp_min(0.0)), torch.zeros_like(z), z)
    facets = microfacets(distribution, alpha, alpha)
    m = facets.sample_visible(w, u, v)
    cosine = dot(w, m).clamp_min(SMALLEST_SQUARE)
    reflectance, cos_t = rounded_reflectance(cosine, eta)
    below = w.z / eta - m.z * (cosine / eta - cos_t)  # the cosine of the refracted direction
    share = (1.0 - reflectance) * escaping(facets, below)
    return share.reshape(len(cosines), -1) @ torch.outer(weight, weight).reshape(-1)


def rounded_reflectance(cosine: Tensor, eta: Tensor) -> tuple[Tensor, Tensor]:
    """Fresnel reflectance, smoothed at the critical angle, where its slope is infinite, and cosine of refraction."""
    _, cos_t = dielectric_reflectance(cosine, eta)
    fourth = cos_t**4
    return unpolarised(cosine, cos_t * (fourth / (fourth + ROUNDED * ROUNDED)), eta), cos_t


@lru_cache
def gauss_legendre(count: int) -> tuple[Tensor, Tensor]:
    """Nodes and weights of Gauss-Legendre quadrature on [0, 1], (count,) float64 each."""
    x, weight = np.polynomial.legendre.leggauss(count)
    return torch.from_numpy(0.5 * x + 0.5), torch.from_numpy(0.5 * weight)
