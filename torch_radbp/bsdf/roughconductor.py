"""Reflection by a rough metal."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from torch_radbp.bsdf.fresnel import conductor_reflectance
from torch_radbp.bsdf.ior import complex_index
from torch_radbp.bsdf.microfacet import MicrofacetKind, half_vector
from torch_radbp.bsdf.roughness import ROUGHNESS, make_rough
from torch_radbp.interface.bsdf import LobeChoice, Values, above, reflects
from torch_radbp.plugin import BSDF, Texture, register
from torch_radbp.plugin.domain import AMOUNT, REFLECTANCE, Domain
from torch_radbp.tensors.vec import Vec3, dot
from torch_radbp.texture.rgb import as_texture


@dataclass(frozen=True)
class RoughConductorKind(MicrofacetKind):
    """The BSDF of a rough conductor. Parameter values: alpha, or alpha_u and alpha_v; eta, k, specular_reflectance.

    Reference: Walter et al. 2007, equations 20, 14 and 24.
    """

    def eval_pdf(self, values: Values, wi: Vec3, wo: Vec3, fixed_lobes: bool = False) -> tuple[Vec3, Tensor]:
        eta, k, reflectance = values[-3:]
        facets, lit, wi, wo = self.facets(values), reflects(wi, wo), above(wi), above(wo)
        m, _ = half_vector(wi + wo)
        density = 0.25 * facets.density(m) * lit
        scale, cosine = density * facets.masking(wi) * facets.masking(wo) * wo.z, dot(wi, m)
        return reflectance * conductor_reflectance(cosine, eta, k) * scale, density * self.per_area(facets, wi, cosine, m.z)

    def sample(self, values: Values, wi: Vec3, choice: LobeChoice, u: Tensor, v: Tensor) -> Vec3:
        wi = above(wi)
        m = self.drawn(values, wi, u, v)
        return m * (2.0 * dot(wi, m)) - wi


@register("bsdf", "roughconductor")
class RoughConductor(BSDF):
    """A metal with a rough surface, black from behind: microfacets that each are a mirror. No light is scattered twice.

    Parameters: `alpha` or `alpha_u` and `alpha_v`, `eta`, `k`, `specular_reflectance`, textures. Derivatives: with respect
    to all parameters; roughness below 1e-4 counts as 1e-4 and has the derivatives that it has there.

    Args:
        distribution: of the microfacets' normals, beckmann or ggx.
        alpha: roughness, 0.1 by default; for Beckmann the root mean square slope times sqrt(2).
        alpha_u, alpha_v: instead of alpha, roughness along the direction in which the surface coordinate u grows, and
            across it. Of a constant colour the mean is used, of a colour bitmap the luminance; likewise for alpha.
        eta: real part of the index of refraction; 0 by default.
        k: imaginary part, the extinction coefficient; 1 by default, which with eta = 0 reflects all light.
        material: name of a metal in `ior.CONDUCTORS`, in place of eta and k; or "none".
        specular_reflectance: a factor on the reflected light; physical surfaces have 1, more is warned of.
        sample_visible: draw only microfacets that the viewer sees. Without it images are the same, but noisier.

    Raises:
        ValueError: if a name is not known, attributes exclude each other, or a value is out of range.
    """

    def __init__(self, *, distribution: str = "beckmann", alpha: Texture | float | None = None,
                 alpha_u: Texture | float | None = None, alpha_v: Texture | float | None = None,
                 eta: Texture | float | None = None, k: Texture | float | None = None, material: str = "none",
                 specular_reflectance: Texture | float = 1.0, sample_visible: bool = True):
        super().__init__()
        make_rough(self, distribution, sample_visible, alpha, alpha_u, alpha_v)
        self.eta, self.k = complex_index(self, material, eta, k)
        self.material = "none"  # its name has become numbers, which may change
        self.specular_reflectance = as_texture(self, "specular_reflectance", specular_reflectance)

    def domains(self) -> dict[str, Domain]:
        return {**ROUGHNESS, "eta": AMOUNT, "k": AMOUNT, "specular_reflectance": REFLECTANCE}

    def kind(self) -> RoughConductorKind:
        """The functions that evaluate and sample this BSDF."""
        return RoughConductorKind(self.distribution, self.alpha is None, self.sample_visible)

    def textures(self) -> tuple[Texture, ...]:
        """The textures of this BSDF's parameters, in the order in which its functions take them."""
        return *self.rough_numbers, self.eta, self.k, self.specular_reflectance
