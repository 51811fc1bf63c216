"""Lambertian reflection."""

from __future__ import annotations

from torch import Tensor

from torch_radbp.plugin import BSDF, Texture, register
from torch_radbp.sampling.warp import cosine_hemisphere_pdf, square_to_cosine_hemisphere
from torch_radbp.texture.rgb import as_texture, check_range
from torch_radbp.vec import Vec3


@register("bsdf", "diffuse")
class Diffuse(BSDF):
    """Reflects the fraction `reflectance` of the light equally into all directions, on the side of the normal.

    Parameters: `reflectance`, a texture with values in [0, 1]. Derivatives: with respect to its texels.
    """

    def __init__(self, *, reflectance: Texture | float = 0.5):
        super().__init__()
        self.reflectance = check_range("reflectance", as_texture("reflectance", reflectance), upper=1.0)

    @staticmethod
    def eval(reflectance: Vec3, wi: Vec3, wo: Vec3) -> Vec3:
        """bsdf * cos, local frame; zero unless both directions lie above the surface."""
        return reflectance * Diffuse.pdf(wi, wo)

    @staticmethod
    def pdf(wi: Vec3, wo: Vec3) -> Tensor:
        """Density of `sample` over solid angle."""
        return cosine_hemisphere_pdf(wo) * (wi.z > 0).to(wo.z.dtype)

    @staticmethod
    def sample(u: Tensor, v: Tensor) -> Vec3:
        """A direction in the local frame, proportional to the cosine."""
        return square_to_cosine_hemisphere(u, v)
