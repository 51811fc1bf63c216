"""A rough dielectric coat on a diffuse base.

The fraction T(z) of the light that passes the coat from direction cosine z is, over the microfacets m that are visible,

    T = mean of (1 - F(w.m)) G1(refracted w),

and the fraction R that the coat reflects back inside is, likewise for the reciprocal index, a mean of F G1(reflected) over
all directions. Both are Gauss-Legendre sums in the random numbers that sample m. Of T a polynomial is made that interpolates
it at Chebyshev points, in

    sqrt(z + 0.001)                                          if the inside is denser: T is steep at grazing angles,
    the cosine of refraction, smoothed by the roughness      if the outside is: T has a shoulder at the critical angle.

At indices of 1.05 and more it is right to 0.002 for Beckmann and 0.008 for GGX, at smaller ones to 0.06. Mitsuba
interpolates linearly between 64 cosines, and sums R over the same 64, both ends included, which is up to 1.5 per cent below
the integral; R is the same sum here.

Reference: Walter et al. 2007, "Microfacet Models for Refraction through Rough Surfaces".
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar, NamedTuple

import numpy as np
import torch
from torch import Tensor

from torch_radbp.bsdf.fresnel import dielectric_reflectance, unpolarised
from torch_radbp.bsdf.kind import Choice, Kind, Values, above, chance_of_lobe, reflects
from torch_radbp.bsdf.microfacet import MicrofacetKind, check_distribution, floored, half_vector, microfacets
from torch_radbp.bsdf.number import ComputedNumbers, OwnNumber
from torch_radbp.bsdf.plastic import Plastic, coat_or_base, coated, specular_chance
from torch_radbp.domain import LARGEST_AMOUNT, NUMBER, Domain
from torch_radbp.plugin import Texture, boolean, register
from torch_radbp.sampling.warp import cosine_hemisphere_pdf, square_to_cosine_hemisphere
from torch_radbp.vec import Vec3, attached, dot, where

TERMS = 11  # of the polynomial
SUMS = 1 + TERMS  # numbers that describe the coat: R, then the polynomial's coefficients
COSINES = 64  # over which R is summed
NODES = 32  # of the quadratures, along each random number
OFFSET = 1e-3  # of the cosine under the root
SMALLEST_SQUARE = 1e-9  # of a smoothed cosine
ROUNDED = 2e-3  # squared cosines of refraction at which the quadratures round off the reflectance


@dataclass(frozen=True)
class RoughPlasticKind(MicrofacetKind):
    """Values: alpha, eta (scalars), `SUMS` numbers that describe the coat, diffuse_reflectance, specular_reflectance.

    Lobe 0 is the coat, lobe 1 the diffuse base; they overlap.
    """

    nonlinear: bool = False

    discrete: ClassVar[bool] = True

    @property
    def slots(self) -> int:
        return 4 + SUMS // 3

    def passes(self, values: Values, z: Tensor) -> Tensor:
        """The fraction of the light from direction cosine `z`, at least 0, that passes the coat: T."""
        _, *coefficients = (number for value in values[2:-2] for number in value)
        x = abscissa(z, values[0].x, values[1].x)
        last = sum_ = torch.zeros_like(z)
        for coefficient in reversed(coefficients[1:]):  # Clenshaw's recurrence
            last, sum_ = sum_, coefficient + 2.0 * x * sum_ - last
        return (coefficients[0] + x * sum_ - last).clamp(0.0, 1.0)

    def diffuse_reflectance(self, values: Values, wi: Vec3) -> Vec3:
        return values[-2]

    def eval_pdf(self, values: Values, wi: Vec3, wo: Vec3, fixed_lobes: bool = False) -> tuple[Vec3, Tensor]:
        eta, internal, (diffuse, specular) = values[1].x, values[2].x, values[-2:]
        facets, lit, wi, wo = self.facets(values), reflects(wi, wo), above(wi), above(wo)
        passes_in = self.passes(values, wi.z)
        m, _ = half_vector(wi + wo)
        of_coat, of_base = 0.25 * facets.density(m) * lit, cosine_hemisphere_pdf(wo) * lit
        reflectance, _ = dielectric_reflectance(dot(wi, m), eta)
        value = specular * (reflectance * of_coat * facets.masking(wi) * facets.masking(wo) * wo.z) + (
            coated(diffuse, internal, self.nonlinear) * (of_base * passes_in * self.passes(values, wo.z) / (eta * eta)))
        chance = chance_of_lobe(specular_chance(1.0 - passes_in, diffuse, specular), fixed_lobes)
        return value, chance * (of_coat / self.area(facets, wi, dot(wi, m), m.z)) + (1.0 - chance) * of_base

    def choose(self, values: Values, wi: Vec3, choice: Tensor, u: Tensor, v: Tensor) -> Choice:
        values, wi = tuple(value.detach() for value in values), above(wi.detach())
        return coat_or_base(specular_chance(1.0 - self.passes(values, wi.z), *values[-2:]), choice)

    def sample(self, values: Values, wi: Vec3, choice: Choice, u: Tensor, v: Tensor) -> Vec3:
        wi = above(wi)
        m = self.drawn(values, wi, u, v)
        return where(choice.lobe == 0, m * (2.0 * dot(wi, m)) - wi, square_to_cosine_hemisphere(u, v))


def abscissa(z: Tensor, alpha: Tensor, eta: Tensor) -> Tensor:
    """The variable of T's polynomial, in [-1, 1], at direction cosine `z`."""
    low, high = variable(torch.zeros_like(z), alpha, eta), variable(torch.ones_like(z), alpha, eta)
    return 2.0 * (variable(z, alpha, eta) - low) / (high - low).clamp_min(SMALLEST_SQUARE) - 1.0


def cosine_of(x: Tensor, alpha: Tensor, eta: Tensor) -> Tensor:
    """The direction cosine at which `abscissa` is `x`."""
    low, high = variable(torch.zeros_like(x), alpha, eta), variable(torch.ones_like(x), alpha, eta)
    square = (low + (high - low) * (0.5 + 0.5 * x)).square()
    bend, shadow = smoothing(alpha, eta)
    cosine2 = square - bend * bend / (4.0 * square) + shadow
    return torch.where(eta >= 1.0, square - OFFSET, torch.sqrt(cosine2.clamp_min(SMALLEST_SQUARE)))


def variable(z: Tensor, alpha: Tensor, eta: Tensor) -> Tensor:
    """The variable of T's polynomial but for its range; see the module's docstring."""
    bend, shadow = smoothing(alpha, eta)
    cosine2 = z * z - shadow  # times eta^2: of refraction
    size = torch.sqrt(cosine2 * cosine2 + bend * bend)
    # (cosine2 + size) / 2 without cancellation.
    square = torch.where(cosine2 > 0, 0.5 * (cosine2 + size), 0.5 * bend * bend / (size + cosine2.abs()))
    return torch.sqrt(torch.where(eta >= 1.0, z + OFFSET, square.clamp_min(SMALLEST_SQUARE)))


def smoothing(alpha: Tensor, eta: Tensor) -> tuple[Tensor, Tensor]:
    """By how much a squared cosine of refraction is smoothed, and 1 - eta^2; of no meaning if the inside is denser."""
    thin = eta.clamp_max(1.0)
    shadow = (1.0 - thin * thin).clamp_min(SMALLEST_SQUARE)
    return 2.0 * floored(alpha).clamp_max(1.0) * thin * torch.sqrt(shadow) + SMALLEST_SQUARE, shadow


class Coat(NamedTuple):
    """What a coat lets through, (SUMS,) float64 each: R and the coefficients of T's polynomial, and their derivatives."""

    numbers: Tensor
    by_alpha: Tensor
    by_eta: Tensor


@lru_cache(maxsize=128)
def coat_of(distribution: str, alpha: float, eta: float) -> Coat:
    """The coat of a roughness and an index of refraction, by quadrature."""
    points = np.cos(math.pi * (np.arange(TERMS) + 0.5) / TERMS)
    fit = torch.from_numpy(np.polynomial.chebyshev.chebvander(points, TERMS - 1).T * (2.0 / TERMS))
    fit[0] *= 0.5
    cosines = torch.linspace(0.0, 1.0, COSINES, dtype=torch.float64, device="cpu").clamp_min(1e-6)

    def leaf(value: float, count: int) -> Tensor:
        return torch.full((count,), value, dtype=torch.float64, device="cpu", requires_grad=True)

    with torch.enable_grad():
        a, e = leaf(alpha, TERMS), leaf(eta, TERMS)
        passing = mean_over_microfacets(distribution, a, e, cosine_of(torch.from_numpy(points), a, e), refract=True)
        b, f = leaf(alpha, COSINES), leaf(eta, COSINES)
        returning = mean_over_microfacets(distribution, b, 1.0 / f, cosines, refract=False) * cosines * (2.0 / COSINES)
        # Every sum depends on a leaf of its own, so that one sweep finds the derivatives of all.
        slopes = torch.autograd.grad(passing.sum() + returning.sum(), (a, e, b, f))

    def together(returned: Tensor, passed: Tensor) -> Tensor:
        return torch.cat([returned.sum()[None], fit @ passed])

    by_alpha, by_eta = together(slopes[2], slopes[0]), together(slopes[3], slopes[1])
    return Coat(together(returning.detach(), passing.detach()), by_alpha, by_eta)


def mean_over_microfacets(distribution: str, alpha: Tensor, eta: Tensor, cosines: Tensor, refract: bool) -> Tensor:
    """The fraction of the light from some direction cosines that a rough boundary refracts or reflects; attached.

    Args:
        alpha, eta, cosines: (M,) float64; the index on the far side over that on the near side.
        refract: the light that passes, or else what is reflected.
    """
    x, weight = (torch.from_numpy(column) * 0.5 for column in np.polynomial.legendre.leggauss(NODES))
    u, v = (number.reshape(-1).repeat(len(cosines)) for number in torch.meshgrid(x + 0.5, x + 0.5, indexing="ij"))
    alpha, eta, z = (number.repeat_interleave(NODES * NODES) for number in (alpha, eta, cosines))
    w = Vec3(torch.sqrt((1.0 - z * z).clamp_min(0.0)), torch.zeros_like(z), z)
    facets = microfacets(distribution, alpha, alpha)
    m = facets.sample_visible(w, u, v)
    cosine = dot(w, m).clamp_min(SMALLEST_SQUARE)
    _, cos_t = dielectric_reflectance(cosine, eta)
    # At the critical angle the slope of the reflectance is infinite; it is rounded off, or sums would have no derivative.
    fourth = cos_t**4
    reflectance = unpolarised(cosine, cos_t * (fourth / (fourth + ROUNDED * ROUNDED)), eta)
    out = w * (1.0 / eta) - m * (cosine / eta - cos_t) if refract else m * (2.0 * cosine) - w
    share = (1.0 - reflectance if refract else reflectance) * facets.masking(above(out)) * out.z.clamp_min(0.0)
    return share.reshape(len(cosines), -1) @ torch.outer(weight, weight).reshape(-1)


@register("bsdf", "roughplastic")
class RoughPlastic(Plastic):
    """A rough plastic, black from behind: a diffuse base under a dielectric coat of microfacets.

    Parameters: `alpha` and `eta`, numbers, the roughness and the index of refraction inside over the one outside;
    `diffuse_reflectance`, `specular_reflectance`, textures. Derivatives: with respect to all of them; roughness below 1e-4
    counts as 1e-4 and has the derivatives that it has there. What R contributes to those of `alpha` and `eta` is the slope
    of its sum over nodes, which ripples about that of the integral by up to 12%; over steps of 1% it averages out.

    The coat is sampled with the probability that Mitsuba has, but by the reflectances at the point and not by their means
    over the surface, and as if each were at least 0.02.

    Args:
        distribution: of the microfacets' normals, beckmann or ggx.
        alpha: roughness; for Beckmann the root mean square slope times sqrt(2).
        diffuse_reflectance: of the base; above 1, where it makes light, it is warned of.
        nonlinear: account for the shift of colours by light that is reflected inside several times.
        int_ior: index of refraction of the coat, a number or a material of `ior.DIELECTRICS`.
        ext_ior: index of refraction outside; must differ from int_ior.
        specular_reflectance: a factor on the light that the coat reflects; physical surfaces have 1, more is warned of.
        sample_visible: draw only microfacets that the viewer sees. Without it images are the same, but noisier.

    Raises:
        ValueError: if a name is not known, or a value is out of range.
    """

    def __init__(self, *, distribution: str = "beckmann", alpha: float = 0.1, diffuse_reflectance: Texture | float = 0.5,
                 nonlinear: bool = False, int_ior: float | str = "polypropylene", ext_ior: float | str = "air",
                 specular_reflectance: Texture | float = 1.0, sample_visible: bool = True):
        super().__init__(diffuse_reflectance=diffuse_reflectance, nonlinear=nonlinear, int_ior=int_ior, ext_ior=ext_ior,
                         specular_reflectance=specular_reflectance)
        if float(self.eta) == 1.0:
            raise ValueError(f"int_ior and ext_ior must differ, or the boundary has no effect; got {int_ior} and {ext_ior}")
        self.distribution = check_distribution(distribution)
        self.sample_visible = boolean("sample_visible", sample_visible)
        self.freeze("alpha", torch.tensor(float(alpha)))
        self.coat_textures = (OwnNumber(self, "alpha"), *self.eta_texture,
                              *(ComputedNumbers(self, "coat", first) for first in range(0, SUMS, 3)))

    def domains(self) -> dict[str, Domain]:
        return {"alpha": NUMBER._replace(low=0.0, limit=LARGEST_AMOUNT), **super().domains()}

    def coat(self) -> Tensor:
        """(SUMS,) numbers that describe the coat, attached to `alpha` and `eta`."""
        found = coat_of(self.distribution, float(self.alpha.detach()), float(self.eta.detach()))
        numbers, by_alpha, by_eta = (part.to(self.alpha) for part in found)
        return attached(numbers, by_alpha * self.alpha + by_eta * self.eta)

    def kind(self) -> Kind:
        """The scattering functions."""
        return RoughPlasticKind(self.distribution, visible=self.sample_visible, nonlinear=self.nonlinear)

    def textures(self) -> tuple[Texture, ...]:
        """What the functions take, in order."""
        return *self.coat_textures, self.diffuse_reflectance, self.specular_reflectance
