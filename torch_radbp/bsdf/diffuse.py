"""Lambertian reflection."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from torch_radbp.interface.bsdf import Kind, LobeChoice, Values
from torch_radbp.plugin import BSDF, Texture, register
from torch_radbp.plugin.domain import REFLECTANCE, Domain
from torch_radbp.sampling.warp import cosine_hemisphere_pdf, square_to_cosine_hemisphere
from torch_radbp.tensors.vec import Vec3
from torch_radbp.texture.rgb import as_texture


@dataclass(frozen=True)
class DiffuseKind(Kind):
    """The BSDF of a Lambertian reflector. Parameter values: reflectance."""

    @property
    def slots(self) -> int:
        return 1

    def diffuse_reflectance(self, values: Values, wi: Vec3) -> Vec3:
        return values[0]

    def eval_pdf(self, values: Values, wi: Vec3, wo: Vec3, fixed_lobes: bool = False) -> tuple[Vec3, Tensor]:
        pdf = cosine_hemisphere_pdf(wo) * (wi.z > 0).to(wi.z.dtype)
        return values[0] * pdf, pdf

    def sample(self, values: Values, wi: Vec3, choice: LobeChoice, u: Tensor, v: Tensor) -> Vec3:
        return square_to_cosine_hemisphere(u, v)


@register("bsdf", "diffuse")
class Diffuse(BSDF):
    """Reflects the fraction `reflectance` of the light equally into all directions, on the side of the normal.

    Parameters: `reflectance`, a texture. Derivatives: with respect to its texels. Values above 1, which Mitsuba takes too
    unless they are written as <rgb>, are used as they are; there the surface makes light, and it is warned of.

    Args:
        reflectance: the fraction of light that is reflected.
    """

    def __init__(self, *, reflectance: Texture | float = 0.5):
        super().__init__()
        self.reflectance = as_texture(self, "reflectance", reflectance)

    def domains(self) -> dict[str, Domain]:
        return {"reflectance": REFLECTANCE}

    def kind(self) -> DiffuseKind:
        """The functions that evaluate and sample this BSDF."""
        return DiffuseKind()

    def textures(self) -> tuple[Texture, ...]:
        """The textures of this BSDF's parameters, in the order in which its functions take them."""
        return (self.reflectance,)
