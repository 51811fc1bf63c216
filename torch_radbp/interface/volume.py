"""The interface between volumes and what reads them: media, phase functions and textures.

A volume has two parts, as a material has: its `VolumeKind`, a hashable value that names the functions, and a table of its
values, attached to its parameters. It is read at points in the world, inside of its bounds and outside.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from torch_radbp.plugin import Volume
from torch_radbp.tensors.vec import Vec3

Table = Any  # a NamedTuple of columns


@dataclass(frozen=True)
class VolumeKind(ABC):
    """The functions of one kind of volume; all tensors are (N,)."""

    @abstractmethod
    def values(self, table: Table, p: Vec3) -> tuple[Tensor, ...]:
        """The values of all channels at points in the world; attached to the table and to the points."""

    @abstractmethod
    def slopes(self, table: Table, p: Vec3) -> tuple[Vec3, ...]:
        """The derivatives of all channels by the points, attached."""

    def eval(self, table: Table, p: Vec3) -> Vec3:
        """The values of three channels at points in the world, or of one channel three times; attached likewise."""
        values = self.values(table, p)
        return Vec3(*(values * 3 if len(values) == 1 else values))


class VolumeFunction(Volume):
    """Base class of volumes' plugins: what they give to media, phase functions and textures."""

    def kind(self) -> VolumeKind:
        """The functions that evaluate the volume."""
        raise TypeError(f"{type(self).__name__} does not define its kind")

    def table(self, dtype: torch.dtype | None = None, device: torch.device | None = None) -> Table:
        """The volume's data: a record of columns, attached; None: dtype or device of the parameters."""
        raise TypeError(f"{type(self).__name__} does not define its table")

    def channels(self) -> int:
        """The number of channels of the volume's values."""
        raise TypeError(f"{type(self).__name__} does not define its channels")

    def entries(self) -> dict[str, Tensor]:
        """The parameters whose entries are the values, by name, attached; none if the values are computed."""
        return {}

    def samples(self) -> Tensor:
        """The stored values, (..., C), whose range contains all that `eval` returns; attached."""
        values, = self.entries().values()
        return values

    def extremes(self) -> tuple[Tensor, Tensor]:
        """Bounds of the values of all channels from above and from below, () each, detached."""
        least, largest = self.samples().detach().aminmax()
        return largest, least

    def cells(self) -> tuple[Tensor | None, Tensor]:
        """The grid, (C, Z, Y, X), detached, between whose cells' centres values are interpolated, continued beyond the unit
        cube (None: there is no grid); and (3, 4) the transform from the world to that cube."""
        largest, _ = self.extremes()
        return None, torch.eye(4, dtype=largest.dtype, device=largest.device)[:3]

    def corners(self) -> Tensor:
        """The corners of the box in the world that a medium of this extinction fills, (8, 3), detached."""
        raise TypeError(f"{type(self).__name__} does not define its corners")
