"""Values on a grid at points between the centres of its cells."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.interface.volume import VolumeKind
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.vec import Vec3, dot, masked


class GridTable(NamedTuple):
    """A grid of K cells; the other columns have one entry."""

    cells: tuple[Tensor, ...]  # (K,) for each channel, x fastest; attached
    size: tuple[Tensor, ...]  # int32, along x, y and z
    to_local: tuple[tuple[Vec3, Tensor], ...]  # the rows of the transform from the world into the unit cube, with its shift


class NearCells(NamedTuple):
    """The eight cells around points, (N,) each, and where these lie between them."""

    cells: tuple[tuple[tuple[Tensor, Tensor], ...], ...]  # by z, y and x
    shares: tuple[Tensor, Tensor, Tensor]  # along x, y and z, in [0, 1), attached
    by_point: tuple[Vec3, ...]  # the derivatives of these by the point


@dataclass(frozen=True)
class GridKind(VolumeKind):
    """Interpolates between the centres of cells, or reads the cell that a point is in."""

    filter_type: str
    wrap_mode: str

    def values(self, table: GridTable, p: Vec3) -> tuple[Tensor, ...]:
        if self.filter_type == "nearest":
            size, place, _ = self.place_of(table, p)
            x, y, z = (self.inside(torch.floor(at.detach()), count) for at, count in zip(place, size))
            return lookup(table.cells, (z * size[1] + y) * size[0] + x)
        cells, (fx, fy, fz), _ = self.around(table, p)
        lower, upper = ([between([lookup(table.cells, cell) for cell in row], fx) for row in layer] for layer in cells)
        return between((between(lower, fy), between(upper, fy)), fz)

    def slopes(self, table: GridTable, p: Vec3) -> tuple[Vec3, ...]:
        if self.filter_type == "nearest":
            return (Vec3.full(p.x, 0.0),) * len(table.cells)
        cells, (fx, fy, fz), by_point = self.around(table, p)
        slopes = []
        for column in table.cells:
            (a, b), (c, d) = ([tuple(lookup((column,), cell) for cell in row) for row in layer] for layer in cells)
            rows = [between(row, fx) for row in (a, b, c, d)]
            along_x = [difference(*row) for row in (a, b, c, d)]
            by_x, = between((between(along_x[:2], fy), between(along_x[2:], fy)), fz)
            by_y, = between((difference(*rows[:2]), difference(*rows[2:])), fz)
            by_z, = between((difference(rows[0], rows[2]), difference(rows[1], rows[3])), fy)
            slopes.append(by_point[0] * by_x + by_point[1] * by_y + by_point[2] * by_z)
        return tuple(slopes)

    def place_of(self, table: GridTable, p: Vec3) -> tuple[tuple[Tensor, ...], list[Tensor], tuple[Vec3, ...]]:
        """The numbers of cells along the axes, points in units of cells, and the derivatives of these coordinates by `p`."""
        only = torch.zeros_like(p.x, dtype=torch.int32)
        size, to_local = lookup(table.size, only), lookup(table.to_local, only)
        return (size, [(dot(row, p) + shift) * count for (row, shift), count in zip(to_local, size)],
                tuple(row * count for (row, _), count in zip(to_local, size)))

    def around(self, table: GridTable, p: Vec3) -> NearCells:
        """The eight cells around points, and the position between their centres."""
        size, place, by_point = self.place_of(table, p)
        (x, fx), (y, fy), (z, fz) = (self.neighbours(at - 0.5, count) for at, count in zip(place, size))
        if self.wrap_mode == "clamp":  # nothing changes outside
            by_point = tuple(masked((at > 0.5) & (at < count - 0.5), row) for row, at, count in zip(by_point, place, size))
        rows = [[(k * size[1] + j) * size[0] for j in y] for k in z]
        return NearCells(tuple(tuple((row + x[0], row + x[1]) for row in layer) for layer in rows), (fx, fy, fz), by_point)

    def neighbours(self, place: Tensor, count: Tensor) -> tuple[tuple[Tensor, Tensor], Tensor]:
        """The two cells around a place along one axis, and how far it is between their centres, attached."""
        if self.wrap_mode == "clamp":  # also places so far away that they are no integers
            place = torch.minimum(place.clamp_min(0.0), (count - 1).to(place.dtype))
        first = torch.floor(place.detach())
        return (self.inside(first, count), self.inside(first + 1.0, count)), place - first

    def inside(self, place: Tensor, count: Tensor) -> Tensor:
        """Wraps whole numbers, given as floats, into [0, count) by the wrap mode; int32."""
        if self.wrap_mode == "clamp":
            return torch.minimum(torch.minimum(place, count.to(place.dtype)).to(torch.int32).clamp_min(0), count - 1)
        cell = place.to(torch.int32)
        if self.wrap_mode == "repeat":
            return torch.remainder(cell, count)
        folded = torch.remainder(cell, 2 * count)
        return torch.minimum(folded, 2 * count - 1 - folded)


def between(ends: Sequence[tuple[Tensor, ...]], share: Tensor) -> tuple[Tensor, ...]:
    """Interpolates linearly between the channels of two places."""
    return tuple(a + (b - a) * share for a, b in zip(*ends))


def difference(first: tuple[Tensor, ...], second: tuple[Tensor, ...]) -> tuple[Tensor, ...]:
    """The second minus the first, channel by channel."""
    return tuple(b - a for a, b in zip(first, second))
