"""Distributions of microfacet normals, their shadowing, and sampling of the normals visible from a direction.

With t = |(alpha_u x, alpha_v y)| for a direction w = (x, y, z), the projected area A(w) = cos / G1 of the facets that w sees
is

    GGX         A = (z + sqrt(z^2 + t^2)) / 2
    Beckmann    A = z (1 + erf(z / t)) / 2 + t exp(-(z / t)^2) / (2 sqrt(pi))

and the density of visible normals is D(m) <w, m> / A(w), without a division by the cosine at grazing directions.

Visible normals of a Beckmann surface are drawn in the space of slopes, where the surface is a normal distribution in each
direction. Seen from w the slopes q along w's azimuth e have the cumulative distribution A(q) / A(z / t), where

    A(q) = z erfc(-q) / 2 + t exp(-q^2) / (2 sqrt(pi)),     q <= z / t,

and the slopes across e keep theirs. Two normal variates s in a *fixed* frame become a visible slope by moving s along e by
q(s . e) - s . e, where q solves A(q) = (1 + erf(s . e)) / 2 * A(z / t). Near normal incidence that is -e t / (2 z), so that
the map is smooth there although e is not; a map that rotates its variates into the frame of e has unbounded derivatives. The
equation is solved by a fixed number of steps to the zero of the local parabola (cubic convergence, exact at the double root
q = z / t), inside the bracket [-sqrt(-log u), min(s . e, z / t)] given by the limits of grazing and of normal incidence,
between which the solution falls monotonically. Its derivative is that of the implicit function theorem.

Reference: Walter et al. 2007, "Microfacet Models for Refraction through Rough Surfaces", equations 25, 27 and 33;
Heitz and d'Eon 2014, "Importance Sampling Microfacet-Based BSDFs using the Distribution of Visible Normals", appendix;
Dupuy and Benyoub 2023, "Sampling Visible GGX Normals with Spherical Caps", listing 3.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.interface.bsdf import Kind, Values
from torch_radbp.tensors.vec import TINY, Vec2, Vec3, dot, normalize

SMALLEST_ALPHA = 1e-4  # as in Mitsuba: a smoother surface counts as this rough
SMALLEST_COSINE = 1e-5  # of a microfacet normal; Beckmann's density is zero long before
SMALLEST_HALF_VECTOR = 1e-14  # squared
LEAST_NUMBER = 2.0**-25  # random numbers are multiples of 2^-24
SQRT_PI = math.sqrt(math.pi)


def half_vector(h: Vec3) -> tuple[Vec3, Tensor]:
    """The unit vector along a half vector `h`, flipped to the side of the normal (the normal if h vanishes), and |h|^2."""
    squared = dot(h, h)
    vanishes = (squared < SMALLEST_HALF_VECTOR).to(h.z.dtype)
    squared = squared.clamp_min(SMALLEST_HALF_VECTOR)
    sign = 1.0 - 2.0 * (h.z < 0).to(h.z.dtype)
    scale = sign * torch.rsqrt(squared) * (1.0 - vanishes)
    return Vec3(h.x * scale, h.y * scale, h.z * scale + vanishes), squared


class GGX(NamedTuple):
    """The GGX distribution of microfacet normals (Trowbridge and Reitz)."""

    alpha_u: Tensor  # (N,) roughness along x and y, attached
    alpha_v: Tensor

    def density(self, m: Vec3) -> Tensor:
        """D(m): area of microfacets with normal `m` per area of the surface and solid angle."""
        area = self.alpha_u * self.alpha_v
        x, y, z = m.x * self.alpha_v, m.y * self.alpha_u, m.z * area
        ratio = area / (x * x + y * y + z * z)
        return ratio * ratio * area * (1.0 / math.pi)

    def projected_area(self, w: Vec3) -> Tensor:
        """The area of microfacets visible from `w`, above the surface: cos / G1. Positive."""
        return 0.5 * (w.z + torch.sqrt(w.z * w.z + stretch(self, w)))

    def masking(self, w: Vec3) -> Tensor:
        """Smith's shadowing G1(w) over the cosine of `w`, above the surface; finite at grazing angles."""
        return 1.0 / self.projected_area(w)

    def sample_visible(self, w: Vec3, u: Tensor, v: Tensor) -> Vec3:
        """Samples visible microfacet normals, with density D(m) <w, m> / `projected_area`; w on or above the horizon."""
        seen = normalize(Vec3(self.alpha_u * w.x, self.alpha_v * w.y, w.z))
        # A point of the unit sphere's cap above -z of the seen direction; u sin^2 = 1 - z^2, free of cancellation.
        fall = v * (1.0 + seen.z)
        radius, phi = torch.sqrt(v) * torch.sqrt(((1.0 + seen.z) * (2.0 - fall)).clamp_min(TINY)), 2.0 * math.pi * u
        h = Vec3(radius * torch.cos(phi), radius * torch.sin(phi), 1.0 - fall) + seen
        return normalize(Vec3(self.alpha_u * h.x, self.alpha_v * h.y, h.z.clamp_min(LEAST_NUMBER)))

    def sample(self, u: Tensor, v: Tensor) -> Vec3:
        """Samples microfacet normals with density D(m) times cosine, whether visible or not."""
        radius, phi = torch.sqrt(u / (1.0 - u)), 2.0 * math.pi * v
        return from_slopes(self, Vec2(radius * torch.cos(phi), radius * torch.sin(phi)))


class Beckmann(NamedTuple):
    """The Beckmann distribution of microfacet normals, whose slopes are normally distributed."""

    alpha_u: Tensor  # (N,) roughness along x and y, attached; root mean square slope times sqrt(2)
    alpha_v: Tensor

    def density(self, m: Vec3) -> Tensor:
        """D(m): area of microfacets with normal `m` per area of the surface and solid angle."""
        z = m.z.clamp_min(SMALLEST_COSINE)
        x, y, cos2 = m.x / (self.alpha_u * z), m.y / (self.alpha_v * z), z * z
        return torch.exp(-x * x - y * y) / (math.pi * self.alpha_u * self.alpha_v * cos2 * cos2)

    def projected_area(self, w: Vec3) -> Tensor:
        """The area of microfacets visible from `w`, above the surface: cos / G1, exactly. Positive."""
        return visible_area(*polar(self, w)[:2])

    def masking(self, w: Vec3) -> Tensor:
        """Smith's shadowing G1(w) over the cosine of `w`, above the surface; finite at grazing angles.

        By the rational function of Walter et al., as Mitsuba has it: right to 0.35 per cent.
        """
        t = torch.sqrt(stretch(self, w).clamp_min(TINY))
        smooth = (w.z >= 1.6 * t).to(t.dtype)
        rational = (3.535 * t + 2.181 * w.z) / (t * t + 2.276 * w.z * t + 2.577 * w.z * w.z)
        return smooth / w.z.clamp_min(SMALLEST_COSINE) + (1.0 - smooth) * rational

    def sample_visible(self, w: Vec3, u: Tensor, v: Tensor) -> Vec3:
        """Samples visible microfacet normals, with density D(m) <w, m> / `projected_area`; w on or above the horizon."""
        z, t, e = polar(self, w)
        s = normal_variates(u, v)
        shift = visible_shift(s.x * e.x + s.y * e.y, z, t)
        x, y = s.x + shift * e.x, s.y + shift * e.y
        return from_slopes(self, Vec2(-x, -y))

    def sample(self, u: Tensor, v: Tensor) -> Vec3:
        """Samples microfacet normals with density D(m) times cosine, whether visible or not."""
        return from_slopes(self, normal_variates(u, v))


def from_slopes(facets: GGX | Beckmann, slopes: Vec2) -> Vec3:
    """Microfacet normals from slopes along u and v in multiples of the roughness."""
    return normalize(Vec3(facets.alpha_u * slopes.x, facets.alpha_v * slopes.y, torch.ones_like(slopes.x)))


DISTRIBUTIONS = {"beckmann": Beckmann, "ggx": GGX}


def microfacets(distribution: str, alpha_u: Tensor, alpha_v: Tensor) -> Beckmann | GGX:
    """The microfacet distribution called `distribution`, with roughness kept above `SMALLEST_ALPHA`."""
    return DISTRIBUTIONS[distribution](floored(alpha_u), floored(alpha_v))


def floored(alpha: Tensor) -> Tensor:
    """Clamps roughness to `SMALLEST_ALPHA`, with the derivative of the identity: so an optimiser can leave 0 again."""
    fixed = alpha.detach()
    return alpha + (fixed.clamp_min(SMALLEST_ALPHA) - fixed)


@dataclass(frozen=True)
class MicrofacetKind(Kind):
    """The BSDF of a surface of microfacets. Parameter values: alpha, or alpha_u and alpha_v, and those of the subclass."""

    distribution: str
    anisotropic: bool = False
    visible: bool = True  # only normals visible from wi are sampled

    @property
    def slots(self) -> int:
        return 4 + self.anisotropic

    @property
    def oriented(self) -> bool:
        return self.anisotropic

    @property
    def steering(self) -> tuple[int, ...]:
        return tuple(range(1 + self.anisotropic))

    def facets(self, values: Values) -> Beckmann | GGX:
        """The distribution of microfacet normals."""
        return microfacets(self.distribution, values[0].x, values[int(self.anisotropic)].x)

    def drawn(self, values: Values, w: Vec3, u: Tensor, v: Tensor) -> Vec3:
        """Samples a microfacet normal for the direction `w` above the surface; attached."""
        return self.facets(values).sample_visible(w, u, v) if self.visible else self.facets(values).sample(u, v)

    def per_area(self, facets: Beckmann | GGX, w: Vec3, cos_i: Tensor, cos_m: Tensor) -> Tensor:
        """The factor that turns D(m) <w, m> into the density of the sampled normals.

        Args:
            facets: of the surface.
            w: the direction for which they are drawn, above the surface.
            cos_i: between it and the normal m.
            cos_m: between m and the surface's normal.
        """
        return 1.0 / facets.projected_area(w) if self.visible else cos_m / cos_i.clamp_min(SMALLEST_COSINE)


def stretch(facets: Beckmann | GGX, w: Vec3) -> Tensor:
    """Squared length of (alpha_u x, alpha_v y), the horizontal part of `w` stretched by the roughness."""
    x, y = facets.alpha_u * w.x, facets.alpha_v * w.y
    return x * x + y * y


def polar(facets: Beckmann, w: Vec3) -> tuple[Tensor, Tensor, Vec2]:
    """Cosine z of `w`, and length t and unit direction e of its horizontal part stretched by the roughness.

    Next to normal incidence, where e is not defined, t is held and e is shorter than one: the distribution depends on e t
    alone in first order, and the error of second order is less than rounding.
    """
    x, y = facets.alpha_u * w.x, facets.alpha_v * w.y
    least = torch.finfo(w.z.dtype).eps ** 0.5 * w.z
    t = torch.sqrt(torch.maximum(x * x + y * y, least * least).clamp_min(TINY))
    return w.z, t, Vec2(x / t, y / t)


def visible_area(z: Tensor, t: Tensor) -> Tensor:
    """The projected area A(z / t) of all microfacets visible from the direction that `polar` describes by z and t."""
    # Detached, because dA/dq is zero at q = z / t.
    q = (z / t).detach()
    return area_below(q, z, t)


def area_below(q: Tensor, z: Tensor, t: Tensor) -> Tensor:
    """The projected area A(q) of microfacets with slopes below q: a sum of positive terms, free of cancellation."""
    return 0.5 * z * torch.erfc(-q) + (0.5 / SQRT_PI) * t * torch.exp(-q * q)


def visible_shift(p: Tensor, z: Tensor, t: Tensor) -> Tensor:
    """The shift q - p <= 0 from a slope p among all to the slope q among visible ones; attached to p, z and t."""
    below = 0.5 * torch.erfc(-p)
    target = below * visible_area(z, t)
    q = solve_visible_slope(p.detach(), below.detach(), target.detach(), z.detach(), t.detach())
    # The implicit function theorem: A(q) - target stays zero. The step has the value 0.
    residual = area_below(q, z, t) - target
    slope = ((z - t * q) * torch.exp(-q * q) / SQRT_PI).detach()
    least = torch.finfo(p.dtype).eps * (z + t).detach()
    return q - (residual - residual.detach()) / torch.maximum(slope, least) - p


def solve_visible_slope(p: Tensor, below: Tensor, target: Tensor, z: Tensor, t: Tensor) -> Tensor:
    """Solves A(q) = `target` for the slope q; not differentiable."""
    grazing = -torch.sqrt(-torch.where(p > 0, torch.log1p(-0.5 * torch.erfc(p.clamp_min(0.0))), torch.log(below)))
    upper = torch.minimum(p, z / t)
    sine = t * torch.rsqrt(z * z + t * t)
    q = torch.minimum(p + (grazing - p) * sine * (0.6 + 0.4 * sine**3), upper)
    for _ in range(3 if p.dtype == torch.float32 else 4):
        bell = torch.exp(-q * q) / SQRT_PI
        value = 0.5 * (z * torch.erfc(-q) + t * bell) - target
        first = (z - t * q) * bell
        second = -t * bell - 2.0 * q * first
        root = torch.sqrt((first * first - 2.0 * value * second).clamp_min(0.0))
        q = q - 2.0 * value / (first + root).clamp_min(TINY)
        q = torch.minimum(torch.maximum(q, grazing), upper)
    return q


def normal_variates(u: Tensor, v: Tensor) -> Vec2:
    """Two normal variates, each with density exp(-x^2) / sqrt(pi).

    Reference: Box and Muller 1958, "A Note on the Generation of Random Normal Deviates".
    """
    radius, phi = torch.sqrt(-torch.log1p(-u)), 2.0 * math.pi * v
    return Vec2(radius * torch.cos(phi), radius * torch.sin(phi))
