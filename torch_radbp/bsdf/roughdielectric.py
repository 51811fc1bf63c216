"""Reflection and refraction by rough glass."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import torch
from torch import Tensor

from torch_radbp.bsdf.dielectric import Dielectric, blend, decide, relative_index
from torch_radbp.bsdf.fresnel import dielectric_reflectance
from torch_radbp.bsdf.microfacet import MicrofacetKind, half_vector
from torch_radbp.bsdf.roughness import ROUGHNESS, make_rough
from torch_radbp.interface.bsdf import LobeChoice, Values, above, on_horizon_unless, side_of, values_for_choice
from torch_radbp.plugin import Texture, register
from torch_radbp.plugin.domain import Domain
from torch_radbp.tensors.vec import Vec3, dot


class Microgeometry(NamedTuple):
    """The microfacet that scatters light between two directions, both flipped to the side of `wi`."""

    transmits: Tensor  # 0 or 1
    possible: Tensor  # 0 or 1: such a microfacet exists and faces the viewer
    m: Vec3  # its normal
    density: Tensor  # D(m), whether visible or not
    cos_i: Tensor  # between wi and the microfacet
    cos_o: Tensor  # between wo and the microfacet, at least 0
    squared: Tensor  # squared length of the half vector
    eta: Tensor  # index on the far side over the one on the near side
    reflectance: Tensor


@dataclass(frozen=True)
class RoughDielectricKind(MicrofacetKind):
    """Rough glass. Parameter values: alpha, or alpha_u and alpha_v; eta, specular_reflectance, specular_transmittance.

    With the half vector h = wi + eta wo of refraction, |dm / dwo| = eta^2 |wo.m| / |h|^2 (Walter et al. 2007, equations 17,
    20, 21, 24); in the BSDF for radiance eta^2 cancels. Between equal indices h would vanish and refraction would be ideal,
    so eta is kept away from 1 by a few square roots of the rounding unit; its derivative is passed on.

    Where a microfacet reflects below the horizon or refracts above it, `sample` returns a direction on the horizon, for
    which `eval` and `pdf` are zero: this light is lost between microfacets.

    Two things are not smooth. A GGX surface has microfacets seen edge-on, of density alpha^2 / pi, and refraction by them
    ends abruptly where the half vector crosses the horizon; derivatives at fixed directions (detached) miss that jump, those
    that follow the microfacet (attached) do not. Next to the critical angle the derivative of the transmittance is so much
    larger than the transmittance that a choice in proportion to the latter gives derivatives without finite variance.
    """

    discrete: ClassVar[bool] = True
    transmits: ClassVar[bool] = True

    @property
    def steering(self) -> tuple[int, ...]:
        return *super().steering, 1 + self.anisotropic

    @property
    def follows(self) -> bool:
        """True: sampling="hybrid" differentiates sampled directions, since fixed ones are noisier on smooth surfaces."""
        return True

    @property
    def jumps(self) -> bool:
        """True for GGX, whose BSDF is discontinuous; see the class."""
        return self.distribution == "ggx"

    def index(self, values: Values, side: Tensor) -> Tensor:
        """Index of refraction of the far side over that of the near side."""
        return relative_index(apart_from_one(values[-3].x), side)

    def microgeometry(self, values: Values, wi: Vec3, wo: Vec3) -> Microgeometry:
        """The microfacet and the Fresnel terms of a pair of directions."""
        side = side_of(wi)
        eta, wi, wo = self.index(values, side), wi * side, wo * side
        transmits = (wo.z < 0).to(side.dtype)
        m, squared = half_vector(wi + wo * (1.0 + transmits * (eta - 1.0)))
        cos_i, cos_o = dot(wi, m), dot(wo, m) * (1.0 - 2.0 * transmits)
        possible = ((wi.z > 0) & (wo.z != 0) & (cos_i > 0) & (cos_o > 0)).to(side.dtype)
        reflectance, _ = dielectric_reflectance(cos_i, eta)
        return Microgeometry(transmits, possible, m, self.facets(values).density(m), cos_i.clamp_min(0.0),
                             cos_o.clamp_min(0.0), squared, eta, reflectance)

    def eval_pdf(self, values: Values, wi: Vec3, wo: Vec3, fixed_lobes: bool = False) -> tuple[Vec3, Tensor]:
        g, facets = self.microgeometry(values, wi, wo), self.facets(values)
        whole_wi, whole_wo = wi, wo
        wi, wo, density = above(wi), above(wo), g.density * g.possible
        # Densities of the half vector over that of the direction, of reflection and of refraction.
        reflected, transmitted = 0.25 * (1.0 - g.transmits), (g.cos_i * g.cos_o / g.squared) * g.transmits
        scattered = values[-2] * (g.reflectance * reflected) + values[-1] * ((1.0 - g.reflectance) * transmitted)
        chance = self.reflectance_by_direction(values, whole_wi, whole_wo) if fixed_lobes else g.reflectance
        return (scattered * (density * facets.masking(wi) * facets.masking(wo) * wo.z),
                (chance * reflected + (1.0 - chance) * transmitted * g.eta * g.eta)
                * (density * self.per_area(facets, wi, g.cos_i, g.m.z)))

    def reflectance_by_direction(self, values: Values, wi: Vec3, wo: Vec3) -> Tensor:
        """The Fresnel reflectance of the microfacet between two directions, attached to the directions alone."""
        return self.microgeometry(values_for_choice(values), wi, wo).reflectance

    def chance_by_direction(self, values: Values, wi: Vec3, wo: Vec3, choice: LobeChoice) -> Tensor:
        reflectance = self.reflectance_by_direction(values, wi, wo)
        return blend(choice, reflectance, 1.0 - reflectance)

    def choose(self, values: Values, wi: Vec3, choice: Tensor, u: Tensor, v: Tensor) -> LobeChoice:
        values, wi = tuple(value.detach() for value in values), wi.detach()
        side = side_of(wi)
        m = self.drawn(values, wi * side, u, v)
        reflectance, _ = dielectric_reflectance(dot(wi * side, m), self.index(values, side))
        return decide(reflectance, choice)

    def sample(self, values: Values, wi: Vec3, choice: LobeChoice, u: Tensor, v: Tensor) -> Vec3:
        side = side_of(wi)
        eta, wi = self.index(values, side), wi * side
        m = self.drawn(values, wi, u, v)
        cos_i = dot(wi, m)
        _, cos_t = dielectric_reflectance(cos_i, eta)
        along = blend(choice, torch.ones_like(eta), 1.0 / eta)
        wo = m * (along * cos_i + blend(choice, cos_i, -cos_t)) - wi * along
        return on_horizon_unless(wo.z * (1.0 - 2.0 * choice.lobe) > 0, wo) * side


def apart_from_one(eta: Tensor) -> Tensor:
    """`eta` moved away from 1 where it is within rounding of it; the derivative is that of the identity."""
    least = 4.0 * torch.finfo(eta.dtype).eps ** 0.5
    gap = eta.detach() - 1.0
    moved = torch.copysign(gap.abs().clamp_min(least), gap)
    return eta + (moved - gap)


@register("bsdf", "roughdielectric")
class RoughDielectric(Dielectric):
    """A rough boundary between two transparent media: microfacets that reflect and refract light once.

    Parameters: `alpha` or `alpha_u` and `alpha_v`, textures; `eta`, a number; `specular_reflectance`,
    `specular_transmittance`, textures. Derivatives: with respect to all parameters; roughness below 1e-4 counts as 1e-4 and
    has the derivatives that it has there.

    Attributes:
        eta: index of refraction inside over the one outside; `int_ior` over `ext_ior` at first.

    Args:
        distribution: of the microfacets' normals, beckmann or ggx.
        alpha: roughness, 0.1 by default; for Beckmann the root mean square slope times sqrt(2).
        alpha_u, alpha_v: instead of alpha, roughness along the direction in which the surface coordinate u grows, and
            across it. Of a constant colour the mean is used, of a colour bitmap the luminance; likewise for alpha.
        int_ior: index of refraction inside, a number or a material of `ior.DIELECTRICS`.
        ext_ior: index of refraction outside; must differ from int_ior.
        specular_reflectance: a factor on reflected light; physical surfaces have 1, more is warned of.
        specular_transmittance: a factor on refracted light; physical surfaces have 1, more is warned of.
        sample_visible: draw only microfacets that the viewer sees. Without it images are the same, but noisier; Mitsuba
            then draws them from a wider distribution.

    Raises:
        ValueError: if a name is not known, attributes exclude each other, or a value is out of range.
    """

    def __init__(self, *, distribution: str = "beckmann", alpha: Texture | float | None = None,
                 alpha_u: Texture | float | None = None, alpha_v: Texture | float | None = None,
                 int_ior: float | str = "bk7", ext_ior: float | str = "air", specular_reflectance: Texture | float = 1.0,
                 specular_transmittance: Texture | float = 1.0, sample_visible: bool = True):
        super().__init__(int_ior=int_ior, ext_ior=ext_ior, specular_reflectance=specular_reflectance,
                         specular_transmittance=specular_transmittance)
        if float(self.eta) == 1.0:
            raise ValueError(f"int_ior and ext_ior must differ, or the boundary has no effect; got {int_ior} and {ext_ior}")
        make_rough(self, distribution, sample_visible, alpha, alpha_u, alpha_v)

    def domains(self) -> dict[str, Domain]:
        return {**ROUGHNESS, **super().domains()}

    def kind(self) -> RoughDielectricKind:
        """The functions that evaluate and sample this BSDF."""
        return RoughDielectricKind(self.distribution, self.alpha is None, self.sample_visible)

    def textures(self) -> tuple[Texture, ...]:
        """The textures of this BSDF's parameters, in the order in which its functions take them."""
        return *self.rough_numbers, *super().textures()
