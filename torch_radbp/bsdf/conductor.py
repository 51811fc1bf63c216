"""Ideal reflection by a smooth metal."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from torch_radbp.bsdf.fresnel import conductor_reflectance
from torch_radbp.bsdf.ior import complex_index
from torch_radbp.interface.bsdf import DeltaKind, LobeChoice, Values, reflects
from torch_radbp.plugin import BSDF, Texture, register
from torch_radbp.plugin.domain import AMOUNT, REFLECTANCE, Domain
from torch_radbp.tensors.vec import Vec3
from torch_radbp.texture.rgb import as_texture


@dataclass(frozen=True)
class ConductorKind(DeltaKind):
    """The BSDF of a smooth conductor. Parameter values: eta, k, specular_reflectance."""

    @property
    def slots(self) -> int:
        return 3

    def sample(self, values: Values, wi: Vec3, choice: LobeChoice, u: Tensor, v: Tensor) -> Vec3:
        return Vec3(-wi.x, -wi.y, wi.z)

    def specular(self, values: Values, wi: Vec3, choice: LobeChoice) -> Vec3:
        eta, k, reflectance = values
        return reflectance * conductor_reflectance(wi.z.abs(), eta, k) * reflects(wi, wi)


@register("bsdf", "conductor")
class Conductor(BSDF):
    """A mirror of metal, black from behind.

    Parameters: `eta`, `k`, `specular_reflectance`, textures. Derivatives: with respect to all parameters, and in attached
    mode to the surface that reflects.

    Args:
        eta: real part of the index of refraction; 0 by default.
        k: imaginary part, the extinction coefficient; 1 by default, which with eta = 0 reflects all light.
        material: name of a metal in `ior.CONDUCTORS`, in place of eta and k; or "none".
        specular_reflectance: a factor on the reflected light; physical surfaces have 1, more is warned of.

    Raises:
        ValueError: if the metal is unknown or given beside eta or k, or if a value is out of range.
    """

    def __init__(self, *, eta: Texture | float | None = None, k: Texture | float | None = None, material: str = "none",
                 specular_reflectance: Texture | float = 1.0):
        super().__init__()
        self.eta, self.k = complex_index(self, material, eta, k)
        self.material = "none"  # its name has become numbers, which may change
        self.specular_reflectance = as_texture(self, "specular_reflectance", specular_reflectance)

    def domains(self) -> dict[str, Domain]:
        return {"eta": AMOUNT, "k": AMOUNT, "specular_reflectance": REFLECTANCE}

    def kind(self) -> ConductorKind:
        """The functions that evaluate and sample this BSDF."""
        return ConductorKind()

    def textures(self) -> tuple[Texture, ...]:
        """The textures of this BSDF's parameters, in the order in which its functions take them."""
        return self.eta, self.k, self.specular_reflectance
