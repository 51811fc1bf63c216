"""Ideal reflection and transmission by a pane of glass that is modelled as one surface.

Between its two boundaries light is reflected again and again. With the reflectance R of one boundary, the pane reflects

    r = R + (1 - R)^2 R (1 + R^2 + R^4 + ...) = 2 R / (1 + R)

and lets 1 - r pass, without a change of direction.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from torch import Tensor

from torch_radbp.bsdf.dielectric import Dielectric, blend, decide
from torch_radbp.bsdf.fresnel import dielectric_reflectance
from torch_radbp.interface.bsdf import DeltaKind, LobeChoice, Values
from torch_radbp.plugin import register
from torch_radbp.tensors.differentiated import settled
from torch_radbp.tensors.vec import Vec3


@dataclass(frozen=True)
class ThinDielectricKind(DeltaKind):
    """Thin glass. Parameter values: eta, specular_reflectance, specular_transmittance. Lobe 0 reflects, 1 transmits."""

    discrete: ClassVar[bool] = True
    transmits: ClassVar[bool] = True
    straight: ClassVar[bool] = True

    @property
    def slots(self) -> int:
        return 3

    def choose(self, values: Values, wi: Vec3, choice: Tensor, u: Tensor, v: Tensor) -> LobeChoice:
        return decide(pane_reflectance(wi.z.abs().detach(), values[0].x.detach()), choice)

    def sample(self, values: Values, wi: Vec3, choice: LobeChoice, u: Tensor, v: Tensor) -> Vec3:
        return Vec3(-wi.x, -wi.y, blend(choice, wi.z, -wi.z))

    def specular(self, values: Values, wi: Vec3, choice: LobeChoice) -> Vec3:
        reflectance = pane_reflectance(wi.z.abs(), values[0].x)
        return values[1] * (reflectance * (1.0 - choice.lobe)) + values[2] * ((1.0 - reflectance) * choice.lobe)

    def null_transmission(self, values: Values, wi: Vec3) -> tuple[Vec3, Tensor]:
        passing = 1.0 - pane_reflectance(wi.z.abs(), values[0].x)
        return values[2] * passing, settled(passing)

    def chooses_null(self, choice: LobeChoice) -> Tensor:
        return choice.lobe > 0


def pane_reflectance(cos_i: Tensor, eta: Tensor) -> Tensor:
    """The fraction of light that a thin pane reflects, all internal reflections included.

    Args:
        cos_i: at least 0, between the direction of incidence and the normal on its side.
        eta: index of refraction inside of the pane over the one outside.
    """
    reflectance, _ = dielectric_reflectance(cos_i, eta)
    return 2.0 * reflectance / (1.0 + reflectance)


@register("bsdf", "thindielectric")
class ThinDielectric(Dielectric):
    """A thin pane of glass, the same from both sides: it reflects as a mirror, and what passes keeps its direction.

    For windows that are one sheet of triangles; a closed body of glass is a `dielectric`. As with `null`, next-event
    estimation does not look through, unless the scene has media.

    Parameters: `eta`, a number; `specular_reflectance`, `specular_transmittance`, textures. Derivatives: with respect to all
    of them.

    Attributes:
        eta: index of refraction inside over the one outside; `int_ior` over `ext_ior` at first.

    Args:
        int_ior: index of refraction of the pane, a number or a material of `ior.DIELECTRICS`.
        ext_ior: the same on both sides of it.
        specular_reflectance: a factor on reflected light; physical surfaces have 1, more is warned of.
        specular_transmittance: a factor on the light that passes; physical surfaces have 1, more is warned of.

    Raises:
        ValueError: if a material is unknown, or a value is out of range.
    """

    def kind(self) -> ThinDielectricKind:
        """The functions that evaluate and sample this BSDF."""
        return ThinDielectricKind()
