"""A point light."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.emitter.attributes import colour, weight
from torch_radbp.emitter.positional import PositionalKind, at
from torch_radbp.interface.emitter import Light, ShadowSource
from torch_radbp.interface.emitter_bounds import LightBounds
from torch_radbp.plugin import Matrix4, Point3, Texture, finite, register
from torch_radbp.plugin.domain import AMOUNT, POINT, Domain
from torch_radbp.tensors.vec import Vec3
from torch_radbp.transforms import affine, transform_points


class PointTable(NamedTuple):
    """The table of point lights, a row for each; attached."""

    place: Vec3


@dataclass(frozen=True)
class PointKind(PositionalKind):
    """Point lights: the same intensity in every direction."""

    def bounds(self, table: PointTable, luminance: Tensor) -> LightBounds:
        return LightBounds.at(table.place.map(lambda c: c.to(luminance)), luminance)


@register("emitter", "point")
class Point(Light):
    """Emits `intensity` (W / sr) from `position` into every direction.

    Parameters: `position` (3,), `intensity`. Derivatives: with respect to both.

    Args:
        position: world coordinates; either this or `to_world`.
        to_world: its translation is the position.
        intensity: W / sr.
    """

    def __init__(self, *, position: Point3 | None = None, to_world: Matrix4 | None = None,
                 intensity: Texture | float = 1.0, sampling_weight: float = 1.0):
        super().__init__()
        if position is not None and to_world is not None:
            raise ValueError("give either position or to_world, not both")
        origin = torch.zeros(1, 3, dtype=torch.get_default_dtype())
        place = None if position is None else finite("position", position, (3,)).to(origin.dtype)
        self.freeze("position", transform_points(affine("to_world", to_world), origin)[0] if place is None else place)
        self.intensity = colour(self, "intensity", intensity)
        self.sampling_weight = weight(sampling_weight)

    to_world = None  # resolved into `position`

    def domains(self) -> dict[str, Domain]:
        return {"position": POINT, "intensity": AMOUNT}

    def kind(self) -> PointKind:
        return PointKind()

    def radiated(self) -> Texture:
        return self.intensity

    def row(self) -> PointTable:
        return PointTable(Vec3.of(self.position))

    def source(self) -> ShadowSource:
        return at(self.position)
