"""An environment of constant radiance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.emitter.attributes import colour, weight
from torch_radbp.interface.emitter import Aim, Light, Pick, SurroundKind
from torch_radbp.plugin import Matrix4, Texture, register
from torch_radbp.plugin.domain import AMOUNT, Domain
from torch_radbp.sampling.sampler import unit
from torch_radbp.sampling.warp import UNIFORM_SPHERE_PDF, square_to_uniform_sphere
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.vec import Vec3
from torch_radbp.transforms import affine


class ConstantTable(NamedTuple):
    """The table of the constant environment, of one row; attached."""

    radiance: Vec3


@dataclass(frozen=True)
class ConstantKind(SurroundKind):
    """A constant environment: the same radiance from every direction."""

    def even(self, table: ConstantTable) -> bool:
        return True

    def aim(self, table: ConstantTable, proposal: ConstantTable, p: Vec3, pick: Pick) -> Aim:
        d = square_to_uniform_sphere(unit(pick.u, p.x.dtype), unit(pick.v, p.x.dtype))
        return Aim(d, pick.pmf * UNIFORM_SPHERE_PDF, radiance=self.radiance(table, d))

    def radiance(self, table: ConstantTable, d: Vec3) -> Vec3:
        return lookup(table.radiance, torch.zeros_like(d.x, dtype=torch.int32))

    def weighing(self, proposal: ConstantTable, d: Vec3) -> Tensor:
        return torch.full_like(d.x, UNIFORM_SPHERE_PDF)


@register("emitter", "constant")
class Constant(Light):
    """An infinitely distant environment of constant `radiance`.

    Parameters: `radiance`. Derivatives: with respect to its value.

    Args:
        radiance: of one colour.
        to_world: checked, as Mitsuba has it, and of no effect: what is the same everywhere does not turn.
    """

    def __init__(self, *, radiance: Texture | float = 1.0, to_world: Matrix4 | None = None, sampling_weight: float = 1.0):
        super().__init__()
        affine("to_world", to_world)
        self.radiance = colour(self, "radiance", radiance)
        self.sampling_weight = weight(sampling_weight)

    to_world = None  # of no effect

    def domains(self) -> dict[str, Domain]:
        return {"radiance": AMOUNT}

    def kind(self) -> ConstantKind:
        return ConstantKind()

    def row(self) -> ConstantTable:
        return ConstantTable(Vec3.of(self.radiance.texels()[0, 0]))
