"""Burley's material for thin sheets, such as leaves, paper and bubbles; the same from both sides.

With the transparent share T and the share D of the base that transmits, it is the sum of

    reflection     T F, by GGX microfacets
    transmission   T (1 - F) times the colour, by microfacets of another roughness that reflect through the sheet: directions
                   are those of a reflection, mirrored at the surface
    diffuse        (1 - T) (1 - D), with sheen; and (1 - T) D through the sheet, after Lambert

A mirrored direction that a microfacet sees from its own side is lost, as in Mitsuba: there the BSDF jumps. Lobes are sampled
in proportion to T / 2, T / 2, (1 - T) (1 - D) and (1 - T) D, each times its rate.

Reference: Burley 2015, "Extending the Disney BRDF to a BSDF with Integrated Subsurface Scattering", section 5.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from torch_radbp.bsdf.burley import (
    ROUGHNESS,
    at_least_some,
    base_profile,
    check_rates,
    facets_of,
    fifth_power,
    mixed,
    normal_reflectance,
    schlick_weight,
    sheen_colour,
    tint_of,
)
from torch_radbp.bsdf.features import FeaturedKind, Number, features_of
from torch_radbp.bsdf.fresnel import dielectric_reflectance
from torch_radbp.bsdf.microfacet import GGX, half_vector
from torch_radbp.bsdf.number import NumberOf
from torch_radbp.interface.bsdf import LobeChoice, Values, above, choice_among, on_horizon_unless, side_of, values_for_choice
from torch_radbp.plugin import BSDF, Texture, register
from torch_radbp.plugin.domain import FRACTION, LARGEST_AMOUNT, REFLECTANCE, Domain
from torch_radbp.sampling.warp import cosine_hemisphere_pdf, square_to_cosine_hemisphere
from torch_radbp.tensors.vec import Vec3, dot, where
from torch_radbp.texture.rgb import as_texture

# Parameters that cost nothing while they are zero, or what they are part of is, in the order of the values.
FEATURES = ("eta", "anisotropic", "spec_trans", "spec_tint", "sheen", "sheen_tint", "flatness", "diff_trans")
PART_OF = {"eta": "spec_trans", "anisotropic": "spec_trans", "sheen_tint": "sheen", "spec_tint": "spec_trans"}
GLOSSY_REFLECTION, GLOSSY_TRANSMISSION, DIFFUSE_REFLECTION, DIFFUSE_TRANSMISSION = range(4)  # lobes
LEAST_TRANSMITTED = 0.3  # of the roughness, with which light passes: that at an index of refraction of 1
RATES = ("specular_reflectance_sampling_rate", "specular_transmittance_sampling_rate", "diffuse_reflectance_sampling_rate",
         "diffuse_transmittance_sampling_rate")


@dataclass(frozen=True)
class PrincipledThinKind(FeaturedKind):
    """The BSDF of a thin principled sheet. Parameter values: base_color, then scalars: roughness, those of `features`."""

    rates: tuple[float, ...]  # sampling rates of the lobes, in order

    always: ClassVar[int] = 2
    transmits: ClassVar[bool] = True
    conserves: ClassVar[bool] = False  # as of `PrincipledKind`

    @property
    def reciprocal(self) -> bool:
        """False if it transmits by microfacets, which lose another share of the light in the reverse direction."""
        return not self.has("spec_trans")

    @property
    def ends(self) -> bool:
        """True if it transmits by microfacets: directions mirrored to a facet's own side are lost, where the BSDF jumps."""
        return self.has("spec_trans")

    @property
    def steering(self) -> tuple[int, ...]:
        return (1, *self.places("eta", "anisotropic")) if self.has("spec_trans") else ()

    def facets(self, values: Values) -> tuple[GGX, GGX]:
        """The GGX distributions of reflection and of transmission; the latter by Burley 2015, figure 15."""
        roughness, anisotropic, eta = values[1].x, self.number(values, "anisotropic"), self.number(values, "eta")
        return facets_of(roughness, anisotropic), facets_of((0.65 * eta - 0.35) * roughness, anisotropic)

    def chances(self, values: Values) -> tuple[Number, ...]:
        """The probabilities of choosing each lobe."""
        clear, through = self.number(values, "spec_trans"), 0.5 * self.number(values, "diff_trans")
        glossy = 0.5 * at_least_some(clear) if self.has("spec_trans") else 0.0
        base = at_least_some(1.0 - clear)
        weights = (glossy, glossy, base * at_least_some(1.0 - through),
                   base * at_least_some(through) if self.has("diff_trans") else 0.0)
        weighed = [rate * weight for rate, weight in zip(self.rates, weights)]
        return tuple(each * (1.0 / sum(weighed)) for each in weighed)

    def diffuse_reflectance(self, values: Values, wi: Vec3) -> Vec3:
        return values[0]

    def eval_pdf(self, values: Values, wi: Vec3, wo: Vec3, fixed_lobes: bool = False) -> tuple[Vec3, Tensor]:
        side, colour = side_of(wi), values[0]
        w, wo = wi * side, wo * side
        behind = (wo.z < 0).to(wo.z.dtype)
        opposite, wo = wo, above(wo)
        lit = ((w.z > 0) & (wo.z > 0)).to(wo.z.dtype)
        before, behind = lit * (1.0 - behind), lit * behind
        chances = self.chances(values_for_choice(values) if fixed_lobes else values)
        clear, through = self.number(values, "spec_trans"), 0.5 * self.number(values, "diff_trans")
        m, _ = half_vector(w + wo)
        cosine, of_base = dot(w, m).clamp_min(0.0), cosine_hemisphere_pdf(wo)
        # The base, and sheen on it.
        flatness = self.number(values, "flatness") if self.has("flatness") else None
        value = colour * (base_profile(w.z, wo.z, cosine, values[1].x, flatness)
                          * ((1.0 - clear) * (1.0 - through)) * of_base * before)
        pdf = chances[DIFFUSE_REFLECTION] * of_base * before
        if self.has("sheen"):
            tint = self.number(values, "sheen_tint") if self.has("sheen_tint") else None
            value = value + sheen_colour(colour, tint) * (
                self.number(values, "sheen") * ((1.0 - clear) * (1.0 - through)) * fifth_power(cosine) * wo.z * before)
        if self.has("diff_trans"):
            value = value + colour * ((1.0 - clear) * through * of_base * behind)
            pdf = pdf + chances[DIFFUSE_TRANSMISSION] * of_base * behind
        # The boundaries.
        if self.has("spec_trans"):
            reflecting, transmitting = self.facets(values)
            reflectance, _ = dielectric_reflectance(cosine, self.number(values, "eta"))
            glossy = 0.25 * reflecting.density(m) * before
            value = value + self.reflectance(values, cosine, reflectance) * (
                clear * glossy * reflecting.masking(w) * reflecting.masking(wo) * wo.z)
            pdf = pdf + chances[GLOSSY_REFLECTION] * glossy / reflecting.projected_area(w)
            glossy = 0.25 * transmitting.density(m) * behind * _crosses(m, opposite)
            value = value + colour * (
                clear * (1.0 - reflectance) * glossy * transmitting.masking(w) * transmitting.masking(wo) * wo.z)
            pdf = pdf + chances[GLOSSY_TRANSMISSION] * glossy / transmitting.projected_area(w)
        return value, pdf

    def reflectance(self, values: Values, cosine: Tensor, plain: Tensor) -> Vec3:
        """The reflectance of a microfacet, in part tinted by the base colour."""
        if not self.has("spec_tint"):
            return Vec3(plain, plain, plain)
        eta, tint = self.number(values, "eta"), self.number(values, "spec_tint")
        grazing, straight = schlick_weight(cosine, eta), tint_of(values[0]) * normal_reflectance(eta)
        return straight.map(lambda c: mixed(plain, mixed(c, 1.0, grazing), tint))

    def choose(self, values: Values, wi: Vec3, choice: Tensor, u: Tensor, v: Tensor) -> LobeChoice:
        return choice_among(self.chances(values_for_choice(values)), choice)

    def sample(self, values: Values, wi: Vec3, choice: LobeChoice, u: Tensor, v: Tensor) -> Vec3:
        side, lobe = side_of(wi), choice.lobe
        through = (lobe == GLOSSY_TRANSMISSION) | (lobe == DIFFUSE_TRANSMISSION)
        wo, usable = square_to_cosine_hemisphere(u, v), torch.ones_like(through)
        if self.has("spec_trans"):
            w = wi * side
            reflecting, transmitting = self.facets(values)
            rough = lobe == GLOSSY_TRANSMISSION
            facets = GGX(*(torch.where(rough, b, a) for a, b in zip(reflecting, transmitting)))
            m = facets.sample_visible(w, u, v)
            mirrored = m * (2.0 * dot(w, m)) - w
            usable = (lobe >= DIFFUSE_REFLECTION) | (mirrored.z > 0) & (~rough | (
                _crosses(m, mirrored._replace(z=-mirrored.z)) > 0))
            wo = where(lobe < DIFFUSE_REFLECTION, mirrored, wo)
        wo = wo._replace(z=torch.where(through, -wo.z, wo.z))
        return on_horizon_unless(usable, wo) * side


def _crosses(m: Vec3, wo: Vec3) -> Tensor:
    """1 where `wo`, below the surface, lies on the far side of the microfacet, else 0."""
    return (dot(wo, m) < 0).to(m.z.dtype)


@register("bsdf", "principledthin")
class PrincipledThin(BSDF):
    """A thin sheet by parameters for artists, most of them between 0 and 1, after Burley; the same from both sides.

    Parameters: textures. Derivatives: with respect to all parameters, also where one is zero. What is not given, or is zero
    and does not require a gradient, costs nothing. Each lobe is sampled with the probability that Mitsuba has, but as if its
    weights were at least 0.02. As in Mitsuba, a white base reflects a few per cent more light than it receives. Directions
    that follow a parameter (`sampling="attached"`) miss the jump at which transmitted light ends: there the derivatives by
    roughness, anisotropy and index of refraction are biased, and a warning says so.

    Args:
        base_color: of the diffuse base, and of light that passes; above 1, where it makes light, it is warned of.
        roughness: its square is the roughness of the microfacets.
        anisotropic: how much the reflections are stretched along the coordinate u.
        spec_trans: 1 is a clear film, 0 a diffuse sheet; without it nothing is glossy.
        eta: index of refraction of the film over the one around it; steers reflectance and roughness.
        spec_tint: by how much reflections have the tint of `base_color`.
        sheen: reflection at grazing angles, as of cloth.
        sheen_tint: by how much it has the tint of `base_color`.
        flatness: by how much the base is like one in which light is scattered below the surface.
        diff_trans: how much of the base's light passes, in [0, 2]: none at 0, all at 2.
        diffuse_reflectance_sampling_rate, specular_reflectance_sampling_rate, specular_transmittance_sampling_rate,
            diffuse_transmittance_sampling_rate: how often these are sampled, relative to each other.

    Raises:
        ValueError: if a value is out of range.
    """

    def __init__(self, *, base_color: Texture | float = 0.5, roughness: Texture | float = 0.5,
                 anisotropic: Texture | float = 0.0, spec_trans: Texture | float = 0.0, eta: Texture | float = 1.5,
                 spec_tint: Texture | float = 0.0, sheen: Texture | float = 0.0, sheen_tint: Texture | float = 0.0,
                 flatness: Texture | float = 0.0, diff_trans: Texture | float = 0.0,
                 diffuse_reflectance_sampling_rate: float = 1.0, specular_reflectance_sampling_rate: float = 1.0,
                 specular_transmittance_sampling_rate: float = 1.0, diffuse_transmittance_sampling_rate: float = 1.0):
        super().__init__()
        given = {"eta": eta, "anisotropic": anisotropic, "spec_trans": spec_trans, "spec_tint": spec_tint, "sheen": sheen,
                 "sheen_tint": sheen_tint, "flatness": flatness, "diff_trans": diff_trans}
        for name, value in {"base_color": base_color, "roughness": roughness, **given}.items():
            setattr(self, name, as_texture(self, name, value))
        self.views = tuple(NumberOf(self, name) for name in ("roughness", *FEATURES))  # no submodules
        self.diffuse_reflectance_sampling_rate = float(diffuse_reflectance_sampling_rate)
        self.specular_reflectance_sampling_rate = float(specular_reflectance_sampling_rate)
        self.specular_transmittance_sampling_rate = float(specular_transmittance_sampling_rate)
        self.diffuse_transmittance_sampling_rate = float(diffuse_transmittance_sampling_rate)
        check_rates({name: getattr(self, name) for name in RATES}, "diffuse_reflectance_sampling_rate")

    def domains(self) -> dict[str, Domain]:
        return {"base_color": REFLECTANCE, **{name: FRACTION for name in FEATURES},
                "roughness": ROUGHNESS._replace(floor=ROUGHNESS.floor / LEAST_TRANSMITTED),
                "diff_trans": Domain(low=0.0, high=2.0), "eta": Domain(low=0.0, low_is_in=False, limit=LARGEST_AMOUNT)}

    @property
    def numbers(self) -> dict[str, NumberOf]:
        """The textures that are read as scalars, by attribute."""
        return dict(zip(("roughness", *FEATURES), self.views))

    def features(self) -> tuple[str, ...]:
        """The names of the optional parameters that have an effect now, in order."""
        return features_of(self, FEATURES, PART_OF)

    def kind(self) -> PrincipledThinKind:
        """The functions that evaluate and sample this BSDF."""
        return PrincipledThinKind(self.features(), tuple(getattr(self, name) for name in RATES))

    def textures(self) -> tuple[Texture, ...]:
        """The textures of this BSDF's parameters, in the order in which its functions take them."""
        numbers = self.numbers
        return self.base_color, numbers["roughness"], *(numbers[name] for name in self.features())
