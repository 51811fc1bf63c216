"""The scattering functions of `principled`: metals, plastics, glass, cloth and lacquer by one set of parameters.

With the metallic share M and the transparent share T of a surface, and the Fresnel reflectance F of the main boundary, it is
the sum of

    reflection   by GGX microfacets: (1 - M) F, in part with the tint of the colour, + M Schlick's reflectance of the colour
    refraction   by the same microfacets: (1 - M) T (1 - F), times the root of the colour
    diffuse      base: (1 - M) (1 - T), darker at grazing angles; and sheen, (1 - M) times its share
    clearcoat    a quarter of its share, by a sharp peak of its own

Behind the surface there are only reflection F and refraction 1 - F by the share (1 - M) T. Sampling is Mitsuba's: diffuse,
clearcoat and main boundary in proportion to (1 - M) (1 - T), a quarter of the clearcoat and 1, each times its rate; then
microfacets refract with the probability (1 - M) T (1 - F).

Reference: Burley 2012, "Physically Based Shading at Disney"; Burley 2015, "Extending the Disney BRDF to a BSDF with
Integrated Subsurface Scattering".
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import torch
from torch import Tensor

from torch_radbp.bsdf.burley import (
    at_least_some,
    base_profile,
    facets_of,
    fifth_power,
    mixed,
    normal_reflectance,
    schlick_weight,
    sheen_colour,
    square_root,
    tint_of,
)
from torch_radbp.bsdf.clearcoat import Clearcoat, shadowing
from torch_radbp.bsdf.dielectric import relative_index
from torch_radbp.bsdf.features import FeaturedKind, Number
from torch_radbp.bsdf.fresnel import dielectric_reflectance
from torch_radbp.bsdf.microfacet import GGX, half_vector
from torch_radbp.bsdf.roughdielectric import apart_from_one
from torch_radbp.interface.bsdf import (
    LobeChoice,
    Values,
    above,
    choice_among,
    on_horizon_unless,
    reflects,
    side_of,
    values_for_choice,
)
from torch_radbp.sampling.warp import cosine_hemisphere_pdf, square_to_cosine_hemisphere
from torch_radbp.tensors.vec import Vec3, dot, where

DIFFUSE, CLEARCOAT, REFRACTION, REFLECTION = range(4)  # lobes
LEAST_SPECULAR = 1e-5  # below it counts as this: the index of refraction has an infinite derivative at zero
LEAST_CHANCE = 1e-12


class Microfacet(NamedTuple):
    """The microfacet that scatters light between two directions, both flipped to the side of `wi`."""

    m: Vec3  # its normal
    front: Number  # 1 if wi is on the side of the surface's normal, else 0
    reflects: Tensor  # 1 if wo lies on the side of wi, else 0
    refracts: Number  # 1 if it does not, and such a microfacet exists, else 0
    cos_i: Tensor  # between wi and m, at least 0
    cos_o: Tensor  # between wo and m, at least 0
    squared: Tensor  # squared length of the half vector
    eta: Tensor  # index of refraction on the far side over the one on the near side
    reflectance: Tensor  # of a boundary between dielectrics


class Weights(NamedTuple):
    """The weights of the parts of a principled material."""

    metallic: Number  # M
    dielectric: Number  # 1 - M
    refracting: Number  # (1 - M) T
    diffuse: Number  # (1 - M) (1 - T)


class Chances(NamedTuple):
    """The probabilities of choosing the diffuse base, the clearcoat and the main boundary."""

    diffuse: Number
    clearcoat: Number
    main: Number
    refracting: Number  # that a microfacet of the main boundary refracts rather than reflects


@dataclass(frozen=True)
class PrincipledKind(FeaturedKind):
    """The principled BSDF. Parameter values: base_color, then scalars: roughness, specular or eta, those of `features`."""

    by_specular: bool
    rates: tuple[float, float, float]  # of sampling the diffuse base, the main boundary and the clearcoat

    always: ClassVar[int] = 3
    conserves: ClassVar[bool] = False  # a white base reflects a little more than all: Burley 2012, section 5.3

    @property
    def transmits(self) -> bool:
        return self.has("spec_trans")

    @property
    def jumps(self) -> bool:
        """True if the material refracts: by rough glass the BSDF is discontinuous in the directions."""
        return self.transmits

    @property
    def steering(self) -> tuple[int, ...]:
        return (1, 2)[:1 + self.transmits] + self.places("anisotropic", "clearcoat_gloss")

    def facets(self, values: Values) -> GGX:
        """The GGX distribution of the main boundary."""
        return facets_of(values[1].x, self.number(values, "anisotropic"))

    def coat(self, values: Values) -> Clearcoat:
        """The microfacet distribution of the clearcoat."""
        return Clearcoat.of(self.number(values, "clearcoat_gloss") + torch.zeros_like(values[1].x))

    def index(self, values: Values) -> Tensor:
        """Index of refraction inside over the one outside."""
        eta = index_by_specular(values[2].x) if self.by_specular else values[2].x
        return apart_from_one(eta) if self.transmits else eta

    def seen(self, values: Values, wi: Vec3) -> tuple[Vec3, Number, Tensor]:
        """`wi` flipped to the front; 1 if it was in front, else -1; and the relative refractive index of its far side."""
        if not self.transmits:
            return above(wi), 1.0, self.index(values)
        side = side_of(wi)
        return wi * side, side, relative_index(self.index(values), side)

    def microfacet(self, values: Values, wi: Vec3, wo: Vec3) -> Microfacet:
        """The microfacet between a pair of directions, with its Fresnel terms."""
        w, side, eta = self.seen(values, wi)
        if not self.transmits:
            m, squared = half_vector(w + above(wo))
            cosine = dot(w, m).clamp_min(0.0)
            reflectance, _ = dielectric_reflectance(cosine, eta)
            return Microfacet(m, 1.0, reflects(wi, wo), 0.0, cosine, cosine, squared, eta, reflectance)
        wo = wo * side
        below = (wo.z < 0).to(eta.dtype)
        m, squared = half_vector(w + wo * (1.0 + below * (eta - 1.0)))
        cos_i, cos_o = dot(w, m), dot(wo, m) * (1.0 - 2.0 * below)
        possible = ((w.z > 0) & (wo.z != 0) & (cos_i > 0) & (cos_o > 0)).to(eta.dtype)
        reflectance, _ = dielectric_reflectance(cos_i, eta)
        return Microfacet(m, 0.5 + 0.5 * side, possible * (1.0 - below), possible * below, cos_i.clamp_min(0.0),
                          cos_o.clamp_min(0.0), squared, eta, reflectance)

    def weights(self, values: Values) -> Weights:
        """The weights of metal, dielectric, glass and diffuse base."""
        metallic, transparent = self.number(values, "metallic"), self.number(values, "spec_trans")
        rest = 1.0 - metallic
        return Weights(metallic, rest, rest * transparent, rest * (1.0 - transparent))

    def chances(self, values: Values, front: Number) -> Chances:
        """The probabilities of choosing each lobe, on one side of the surface."""
        weights, (diffuse, main, clearcoat) = self.weights(values), self.rates
        base = diffuse * at_least_some(weights.diffuse) * front
        coat = 0.25 * clearcoat * at_least_some(self.number(values, "clearcoat")) * front if self.has("clearcoat") else 0.0
        main, refracting = mixed(1.0, main, front), mixed(1.0, at_least_some(weights.refracting), front)
        scale = 1.0 / (base + coat + main)
        return Chances(base * scale, coat * scale, main * scale, refracting if self.transmits else 0.0)

    def reflectance(self, values: Values, weights: Weights, at: Microfacet) -> Vec3:
        """The reflectance of a microfacet of the main boundary."""
        colour, tint = values[0], self.number(values, "spec_tint")
        plain = weights.dielectric * (1.0 - tint) * at.reflectance
        reflected = Vec3(plain, plain, plain)
        grazing = schlick_weight(at.cos_i, at.eta) if self.has("metallic") or self.has("spec_tint") else None
        if self.has("metallic"):
            reflected = reflected + colour.map(lambda c: mixed(c, 1.0, grazing)) * weights.metallic
        if self.has("spec_tint"):
            straight = tint_of(colour) * normal_reflectance(at.eta)
            reflected = reflected + straight.map(lambda c: mixed(c, 1.0, grazing)) * (weights.dielectric * tint)
        behind = weights.refracting * at.reflectance
        return reflected.map(lambda c: mixed(behind, c, at.front)) if self.transmits else reflected

    def diffuse_reflectance(self, values: Values, wi: Vec3) -> Vec3:
        return values[0]

    def eval_pdf(self, values: Values, wi: Vec3, wo: Vec3, fixed_lobes: bool = False) -> tuple[Vec3, Tensor]:
        at, facets, weights = self.microfacet(values, wi, wo), self.facets(values), self.weights(values)
        for_lobes = values_for_choice(values) if fixed_lobes else values
        chances = self.chances(for_lobes, at.front)
        reflectance = self.microfacet(for_lobes, wi, wo).reflectance if fixed_lobes else at.reflectance
        colour, lit, wi, wo = values[0], at.reflects * at.front, above(wi), above(wo)
        # The base, and sheen on it.
        of_base = cosine_hemisphere_pdf(wo) * lit
        flatness = self.number(values, "flatness") if self.has("flatness") else None
        value = colour * (base_profile(wi.z, wo.z, at.cos_o, values[1].x, flatness) * weights.diffuse * of_base)
        pdf = chances.diffuse * of_base
        if self.has("sheen"):
            tint = self.number(values, "sheen_tint") if self.has("sheen_tint") else None
            value = value + sheen_colour(colour, tint) * (
                self.number(values, "sheen") * weights.dielectric * fifth_power(at.cos_o) * wo.z * lit)
        # The main boundary.
        density = facets.density(at.m)
        reflected, refracted = 0.25 * density * at.reflects, density * (at.cos_i * at.cos_o / at.squared) * at.refracts
        shadowed = facets.masking(wi) * facets.masking(wo) * wo.z
        value = value + self.reflectance(values, weights, at) * (reflected * shadowed)
        scattered = reflected
        if self.transmits:
            value = value + colour.map(square_root) * (weights.refracting * (1.0 - at.reflectance) * refracted * shadowed)
            refracts = chances.refracting * (1.0 - reflectance)
            scattered = (1.0 - refracts) * reflected + refracts * refracted * at.eta * at.eta
        pdf = pdf + chances.main * scattered / facets.projected_area(wi)
        if self.has("clearcoat"):
            of_coat = 0.25 * self.coat(values).density(at.m) * lit
            grazing = mixed(0.04, 1.0, schlick_weight(at.cos_i, at.eta))
            coat = self.number(values, "clearcoat") * grazing * shadowing(wi) * shadowing(wo) * wo.z * of_coat
            value = value + Vec3(coat, coat, coat)
            pdf = pdf + chances.clearcoat * of_coat * at.m.z / at.cos_o.clamp_min(LEAST_CHANCE)
        return value, pdf

    def choose(self, values: Values, wi: Vec3, choice: Tensor, u: Tensor, v: Tensor) -> LobeChoice:
        values = tuple(value.detach() for value in values)
        w, side, eta = self.seen(values, wi.detach())
        chances = self.chances(values, 0.5 + 0.5 * side)
        refracts: Number = 0.0
        if self.transmits:
            m = self.facets(values).sample_visible(w, u, v)
            refracts = chances.main * chances.refracting * (1.0 - dielectric_reflectance(dot(w, m), eta)[0])
        return choice_among((chances.diffuse, chances.clearcoat, refracts, chances.main - refracts), choice)

    def sample(self, values: Values, wi: Vec3, choice: LobeChoice, u: Tensor, v: Tensor) -> Vec3:
        w, side, eta = self.seen(values, wi)
        m = self.facets(values).sample_visible(w, u, v)
        cos_i = dot(w, m)
        wo = m * (2.0 * cos_i) - w
        if self.transmits:
            _, cos_t = dielectric_reflectance(cos_i, eta)
            wo = where(choice.lobe == REFRACTION, m * (cos_i / eta - cos_t) - w * (1.0 / eta), wo)
        if self.has("clearcoat"):
            m = self.coat(values).sample(u, v)
            wo = where(choice.lobe == CLEARCOAT, m * (2.0 * dot(w, m)) - w, wo)
        wo = where(choice.lobe == DIFFUSE, square_to_cosine_hemisphere(u, v), wo)
        if not self.transmits:
            return wo
        refracted = (choice.lobe == REFRACTION).to(wo.z.dtype)
        return on_horizon_unless(wo.z * (1.0 - 2.0 * refracted) > 0, wo) * side

    def chance_by_direction(self, values: Values, wi: Vec3, wo: Vec3, choice: LobeChoice) -> Tensor | None:
        if not self.transmits:
            return None
        at = self.microfacet(values, wi, wo)
        refracts = self.chances(values, at.front).refracting * (1.0 - at.reflectance)
        return torch.where(choice.lobe == REFLECTION, 1.0 - refracts, torch.where(choice.lobe == REFRACTION, refracts, 1.0))


def index_by_specular(specular: Tensor) -> Tensor:
    """The relative index of refraction whose reflectance at normal incidence is 0.08 `specular`."""
    fixed = specular.detach()
    root = torch.sqrt(0.08 * (specular + (fixed.clamp_min(LEAST_SPECULAR) - fixed)))
    return 2.0 / (1.0 - root) - 1.0
