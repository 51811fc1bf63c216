"""A rough dielectric coat on a diffuse base.

Reference: Walter et al. 2007, "Microfacet Models for Refraction through Rough Surfaces".
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from torch_radbp.bsdf.fresnel import dielectric_reflectance
from torch_radbp.bsdf.microfacet import SMALLEST_ALPHA, MicrofacetKind, half_vector
from torch_radbp.bsdf.number import ComputedNumbers, OwnNumber
from torch_radbp.bsdf.plastic import Plastic, coat_or_base, coated, specular_chance
from torch_radbp.bsdf.rough_coat import SUMS, abscissa, coat_of
from torch_radbp.bsdf.roughness import check_distribution
from torch_radbp.interface.bsdf import Kind, LobeChoice, Values, above, chance_of_lobe, reflects
from torch_radbp.plugin import Texture, boolean, register
from torch_radbp.plugin.domain import LARGEST_AMOUNT, NUMBER, Domain
from torch_radbp.sampling.warp import cosine_hemisphere_pdf, square_to_cosine_hemisphere
from torch_radbp.tensors.vec import Vec3, attached, dot, where


@dataclass(frozen=True)
class RoughPlasticKind(MicrofacetKind):
    """Rough plastic. Parameter values: alpha, eta, `SUMS` numbers of the coat, diffuse_reflectance, specular_reflectance.

    Lobe 0 is the coat, lobe 1 the diffuse base; they overlap.
    """

    nonlinear: bool = False

    discrete: ClassVar[bool] = True

    @property
    def slots(self) -> int:
        return 4 + SUMS // 3

    def passes(self, values: Values, z: Tensor) -> Tensor:
        """T, the fraction of light from direction cosine `z` >= 0 that passes the coat."""
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
        return value, chance * (of_coat * self.per_area(facets, wi, dot(wi, m), m.z)) + (1.0 - chance) * of_base

    def choose(self, values: Values, wi: Vec3, choice: Tensor, u: Tensor, v: Tensor) -> LobeChoice:
        values, wi = tuple(value.detach() for value in values), above(wi.detach())
        return coat_or_base(specular_chance(1.0 - self.passes(values, wi.z), *values[-2:]), choice)

    def sample(self, values: Values, wi: Vec3, choice: LobeChoice, u: Tensor, v: Tensor) -> Vec3:
        wi = above(wi)
        m = self.drawn(values, wi, u, v)
        return where(choice.lobe == 0, m * (2.0 * dot(wi, m)) - wi, square_to_cosine_hemisphere(u, v))


@register("bsdf", "roughplastic")
class RoughPlastic(Plastic):
    """A rough plastic, black from behind: a diffuse base under a dielectric coat of microfacets.

    Parameters: `alpha`, `eta`, numbers; `diffuse_reflectance`, `specular_reflectance`, textures. Derivatives: with respect
    to all parameters; roughness below 1e-4 counts as 1e-4 and has the derivatives that it has there.

    The coat is sampled with the probability that Mitsuba has, but by the reflectances at the point and not by their means
    over the surface, and as if each were at least 0.02.

    Attributes:
        eta: index of refraction inside over the one outside; `int_ior` over `ext_ior` at first.

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
        return {"alpha": NUMBER._replace(low=0.0, limit=LARGEST_AMOUNT, floor=SMALLEST_ALPHA), **super().domains()}

    def coat(self) -> Tensor:
        """(SUMS,) the tabulated transmittance of the coat, see `rough_coat`, attached to `alpha` and `eta`."""
        tabulated = coat_of(self.distribution, float(self.alpha.detach()), float(self.eta.detach()))
        numbers, by_alpha, by_eta = (part.to(self.alpha) for part in tabulated)
        return attached(numbers, by_alpha * self.alpha + by_eta * self.eta)

    def kind(self) -> Kind:
        """The functions that evaluate and sample this BSDF."""
        return RoughPlasticKind(self.distribution, visible=self.sample_visible, nonlinear=self.nonlinear)

    def textures(self) -> tuple[Texture, ...]:
        """The textures of this BSDF's parameters, in the order in which its functions take them."""
        return *self.coat_textures, self.diffuse_reflectance, self.specular_reflectance
