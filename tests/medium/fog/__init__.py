"""A medium that only absorbs, as a plugin of its own: nothing else in the package or the tests knows it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.interface.medium import MediumKind
from torch_radbp.plugin import Medium, Texture, register
from torch_radbp.plugin.domain import AMOUNT, Domain
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.vec import Ray, Vec3
from torch_radbp.texture.rgb import as_texture


class FogTable(NamedTuple):
    """One row."""

    sigma_a: Vec3  # 1 / length, attached


@dataclass(frozen=True)
class FogKind(MediumKind):
    """The same absorption everywhere: Beer's law."""

    def transmittance(self, table: FogTable, ray: Ray, distance: Tensor) -> Vec3:
        sigma_a = lookup(table.sigma_a, torch.zeros_like(distance, dtype=torch.int32))
        return sigma_a.map(lambda sigma: torch.exp(-sigma * distance))


@register("medium", "absorbing_fog")
class AbsorbingFog(Medium):
    """Absorbs `sigma_a` of the light per unit of length, by colour; fills the whole scene."""

    def __init__(self, *, sigma_a: Texture | float = 1.0):
        super().__init__()
        self.sigma_a = as_texture(self, "sigma_a", sigma_a)

    def domains(self) -> dict[str, Domain]:
        return {"sigma_a": AMOUNT}

    def kind(self) -> FogKind:
        return FogKind()

    def row(self) -> FogTable:
        return FogTable(Vec3.of(self.sigma_a.texels()[0, 0]))
