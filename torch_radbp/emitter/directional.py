"""Parallel light from far away."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import torch
from torch import Tensor

from torch_radbp.emitter.attributes import colour, weight
from torch_radbp.interface.emitter import Aim, Light, LightKind, Pick, ShadowSource
from torch_radbp.plugin import Matrix4, Point3, Texture, finite, register
from torch_radbp.plugin.domain import AMOUNT, POSE, Domain
from torch_radbp.pose import look_at
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.vec import Vec3
from torch_radbp.transforms import transform


class DirectionalTable(NamedTuple):
    """The table of directional lights, a row for each; attached."""

    towards: Vec3  # unit direction towards it


@dataclass(frozen=True)
class DirectionalKind(LightKind):
    """Directional lights: parallel light from far away."""

    delta: ClassVar[bool] = True
    distant: ClassVar[bool] = True
    parallel: ClassVar[bool] = True

    def aim(self, table: DirectionalTable, proposal: DirectionalTable, p: Vec3, pick: Pick) -> Aim:
        return Aim(lookup(table.towards, pick.row), pick.pmf)


@register("emitter", "directional")
class Directional(Light):
    """Shines along one direction, with `irradiance` (W / m^2) on a surface perpendicular to it.

    Parameters: `to_world` (4, 4), `irradiance`. Derivatives: with respect to both.

    Args:
        direction: in which the light travels, of any length; either this or `to_world`.
        irradiance: W / m^2.
        to_world: its +z axis is that direction; scale and the other axes have no effect.
    """

    def __init__(self, *, direction: Point3 | None = None, to_world: Matrix4 | None = None,
                 irradiance: Texture | float = 1.0, sampling_weight: float = 1.0):
        super().__init__()
        if direction is not None and to_world is not None:
            raise ValueError("give either direction or to_world, not both")
        self.freeze("to_world", transform("to_world", to_world if direction is None else facing(direction)))
        self.irradiance = colour(self, "irradiance", irradiance)
        self.sampling_weight = weight(sampling_weight)

    direction = None  # resolved into `to_world`

    def domains(self) -> dict[str, Domain]:
        return {"to_world": POSE, "irradiance": AMOUNT}

    def kind(self) -> DirectionalKind:
        return DirectionalKind()

    def radiated(self) -> Texture:
        return self.irradiance

    def towards(self) -> Tensor:
        """The unit direction towards the light, (3,), attached."""
        return -torch.nn.functional.normalize(self.to_world[:3, 2], dim=0)

    def row(self) -> DirectionalTable:
        return DirectionalTable(Vec3.of(self.towards()))

    def source(self) -> ShadowSource:
        towards = self.towards().detach()
        return ShadowSource(torch.cat([towards, towards.new_zeros(1)]), torch.zeros_like(towards))


def facing(direction: Tensor) -> Tensor:
    """(4, 4) rotation whose +z points along `direction`, its other axes as Mitsuba's.

    Raises:
        ValueError: if the direction is zero.
    """
    direction = finite("direction", direction, (3,)).double()
    if not direction.any():
        raise ValueError("direction must not be zero")
    return look_at(torch.zeros_like(direction), direction)
