"""Ideal reflection and refraction by smooth glass."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from torch_radbp.bsdf.fresnel import dielectric_reflectance
from torch_radbp.bsdf.ior import index_of_refraction
from torch_radbp.bsdf.number import OwnNumber
from torch_radbp.interface.bsdf import DeltaKind, LobeChoice, Values, side_of
from torch_radbp.plugin import BSDF, Texture, register
from torch_radbp.plugin.domain import NUMBER, REFLECTANCE, Domain
from torch_radbp.tensors.vec import Vec3
from torch_radbp.texture.rgb import as_texture

LEAST_COSINE = 1e-6


def relative_index(eta: Tensor, side: Tensor) -> Tensor:
    """Index of refraction of the far side over that of the near side; `eta`: of the inside over the outside."""
    outside = 0.5 + 0.5 * side
    return outside * eta + (1.0 - outside) / eta


def blend(choice: LobeChoice, reflected: Tensor, transmitted: Tensor) -> Tensor:
    """Selects the value of the chosen lobe: that of reflection or that of transmission."""
    return reflected + choice.lobe * (transmitted - reflected)


def decide(reflectance: Tensor, choice: Tensor) -> LobeChoice:
    """Chooses reflection with the detached probability `reflectance`, else transmission."""
    transmits = (choice >= reflectance).to(reflectance.dtype)
    return LobeChoice(transmits, torch.where(choice >= reflectance, 1.0 - reflectance, reflectance))


@dataclass(frozen=True)
class DielectricKind(DeltaKind):
    """A smooth dielectric boundary. Parameter values: eta (a scalar), specular_reflectance, specular_transmittance.

    Radiance that crosses the boundary is scaled by the squared ratio of the indices.
    Reference: Veach 1997, "Robust Monte Carlo Methods for Light Transport Simulation", section 5.2.
    """

    discrete: ClassVar[bool] = True
    transmits: ClassVar[bool] = True

    @property
    def steering(self) -> tuple[int, ...]:
        return (0,)

    @property
    def slots(self) -> int:
        return 3

    def choose(self, values: Values, wi: Vec3, choice: Tensor, u: Tensor, v: Tensor) -> LobeChoice:
        wi, eta = wi.detach(), values[0].x.detach()
        return decide(dielectric_reflectance(wi.z.abs(), relative_index(eta, side_of(wi)))[0], choice)

    def sample(self, values: Values, wi: Vec3, choice: LobeChoice, u: Tensor, v: Tensor) -> Vec3:
        side = side_of(wi)
        eta = relative_index(values[0].x, side)
        _, cos_t = dielectric_reflectance(wi.z.abs(), eta)
        along = -blend(choice, torch.ones_like(eta), 1.0 / eta)
        return Vec3(wi.x * along, wi.y * along, blend(choice, wi.z, -side * cos_t))

    def specular(self, values: Values, wi: Vec3, choice: LobeChoice) -> Vec3:
        eta = relative_index(values[0].x, side_of(wi))
        reflectance, _ = dielectric_reflectance(wi.z.abs(), eta)
        transmittance = (1.0 - reflectance) / (eta * eta)
        return values[1] * (reflectance * (1.0 - choice.lobe)) + values[2] * (transmittance * choice.lobe)

    def spread(self, values: Values, wi: Vec3, choice: LobeChoice) -> Tensor:
        eta = relative_index(values[0].x, side_of(wi))
        _, cos_t = dielectric_reflectance(wi.z.abs(), eta)
        transmitted = wi.z.abs() / (eta * eta * cos_t.clamp_min(LEAST_COSINE))
        return blend(choice, torch.ones_like(eta), transmitted)


@register("bsdf", "dielectric")
class Dielectric(BSDF):
    """A smooth boundary between two transparent media, such as glass and air; the normal points to the outside.

    Parameters: `eta`, a number; `specular_reflectance`, `specular_transmittance`, textures. Derivatives: with respect to all
    parameters; of directions, in attached mode, with respect to `eta` and the surface.

    Attributes:
        eta: index of refraction inside over the one outside; `int_ior` over `ext_ior` at first.

    Args:
        int_ior: index of refraction inside, a number or a material of `ior.DIELECTRICS`.
        ext_ior: the same outside.
        specular_reflectance: a factor on reflected light; physical surfaces have 1, more is warned of.
        specular_transmittance: a factor on refracted light; physical surfaces have 1, more is warned of.

    Raises:
        ValueError: if a material is unknown, or a value is out of range.
    """

    def __init__(self, *, int_ior: float | str = "bk7", ext_ior: float | str = "air",
                 specular_reflectance: Texture | float = 1.0, specular_transmittance: Texture | float = 1.0):
        super().__init__()
        self.ext_ior = index_of_refraction("ext_ior", ext_ior)
        self.freeze("eta", torch.tensor(index_of_refraction("int_ior", int_ior) / self.ext_ior))
        self.eta_texture = (OwnNumber(self, "eta"),)  # a tuple, so that it is no submodule
        self.specular_reflectance = as_texture(self, "specular_reflectance", specular_reflectance)
        self.specular_transmittance = as_texture(self, "specular_transmittance", specular_transmittance)

    def domains(self) -> dict[str, Domain]:
        return {"eta": NUMBER._replace(low=0.0, low_is_in=False), "specular_reflectance": REFLECTANCE,
                "specular_transmittance": REFLECTANCE}

    @property
    def int_ior(self) -> float:
        """Index of refraction inside, from the current `eta`."""
        return float(self.eta.detach()) * self.ext_ior

    def kind(self) -> DielectricKind:
        """The functions that evaluate and sample this BSDF."""
        return DielectricKind()

    def textures(self) -> tuple[Texture, ...]:
        """The textures of this BSDF's parameters, in the order in which its functions take them."""
        return *self.eta_texture, self.specular_reflectance, self.specular_transmittance
