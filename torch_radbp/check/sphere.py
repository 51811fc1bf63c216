"""Adaptive cells of the sphere, smaller where more samples fall, and integrals over each.

Cells lie between meridians and circles of latitude around a pole on the horizon, so that the horizon, where BSDFs end, is a
border of cells, and cells are not drawn out where lobes have their peaks.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.tensors.vec import Vec3

ROWS, COLUMNS = 16, 32  # of the coarsest cells: polar angle, longitude
DEEPEST = 16  # halvings of a cell: 3e-6 radians
NODES = 12  # midpoints of a cell along each axis; every third of them are those of the coarse estimate
COARSE = 3
AZIMUTH = 0.7  # of the directions that are farthest from both poles
BATCH = 1 << 17  # directions that functions get at once


class Integral(NamedTuple):
    """Integrals over cells, (cells,) float64 each."""

    value: Tensor
    error: Tensor  # of the quadrature, estimated by one with fewer nodes


class Cells(NamedTuple):
    """Cells in polar angle and longitude that cover the sphere: (C,) int64 each."""

    level: Tensor  # number of halvings along both axes
    row: Tensor  # index along the polar angle at this level
    column: Tensor  # index along the longitude

    @staticmethod
    def around(w: Vec3, most: int) -> Cells:
        """Cells with at most `most` of some directions each, or at the finest level."""
        level, row, column = 0, *(each.flatten() for each in torch.meshgrid(
            torch.arange(ROWS), torch.arange(COLUMNS), indexing="ij"))
        finished = []
        while len(row):
            full = (_counted(w, level, row, column) > most) & (level < DEEPEST)
            finished.append(Cells(torch.full_like(row[~full], level), row[~full], column[~full]))
            halves = torch.tensor([0, 0, 1, 1]), torch.tensor([0, 1, 0, 1])
            row, column = ((2 * each[full][:, None] + half).flatten() for each, half in zip((row, column), halves))
            level += 1
        return Cells(*(torch.cat(parts) for parts in zip(*finished)))

    def counts(self, w: Vec3) -> Tensor:
        """(C,) the number of directions in each cell."""
        counts = torch.zeros_like(self.row)
        for level in self.level.unique().tolist():
            of_level = self.level == level
            counts[of_level] = _counted(w, level, self.row[of_level], self.column[of_level])
        return counts

    def integrals(self, functions: Callable[[Vec3], Sequence[Tensor]]) -> list[Integral]:
        """The integrals over solid angle of functions of directions.

        Args:
            functions: from (N,) directions to one (N,) tensor for each function.
        """
        middles = (torch.arange(NODES, dtype=torch.float64) + 0.5) / NODES
        height, width = (size / (count * 2.0**self.level) for size, count in ((math.pi, ROWS), (2 * math.pi, COLUMNS)))
        polar = ((self.row[:, None] + middles) * height[:, None])[:, :, None].expand(-1, -1, NODES)
        longitude = ((self.column[:, None] + middles) * width[:, None])[:, None, :].expand(-1, NODES, -1)
        polar, longitude = polar.reshape(-1), longitude.reshape(-1)
        values = [functions(unit_vectors(*part)) for part in zip(polar.split(BATCH), longitude.split(BATCH))]
        sine, area = polar.sin().reshape(-1, NODES, NODES), height * width
        integrals = []
        for value in map(torch.cat, zip(*values)):
            value = value.detach().double().reshape(-1, NODES, NODES) * sine
            fine, coarse = (each.mean((1, 2)) * area for each in (value, value[:, COARSE // 2::COARSE, COARSE // 2::COARSE]))
            integrals.append(Integral(fine, (fine - coarse).abs() / COARSE))
        return integrals


def unit_vectors(polar: Tensor, longitude: Tensor) -> Vec3:
    """Unit vectors from polar angle and longitude."""
    ahead, side = polar.sin() * longitude.cos(), polar.cos()
    c, s = math.cos(AZIMUTH), math.sin(AZIMUTH)
    return Vec3(c * ahead - s * side, s * ahead + c * side, polar.sin() * longitude.sin())


def angles(w: Vec3) -> tuple[Tensor, Tensor]:
    """Polar angle and longitude of directions; the latter is 0 to pi above the horizon."""
    c, s = math.cos(AZIMUTH), math.sin(AZIMUTH)
    ahead, side = c * w.x + s * w.y, c * w.y - s * w.x
    return torch.atan2(torch.hypot(ahead, w.z), side), torch.atan2(w.z, ahead).remainder(2 * math.pi)


def _counted(w: Vec3, level: int, row: Tensor, column: Tensor) -> Tensor:
    """The number of directions in each cell of one level."""
    rows, columns = ROWS << level, COLUMNS << level
    polar, longitude = angles(w)
    keys = (polar * (rows / math.pi)).long().clamp_max(rows - 1) * columns
    keys = (keys + (longitude * (columns / (2 * math.pi))).long().clamp_max(columns - 1)).sort().values
    wanted = row * columns + column
    return torch.searchsorted(keys, wanted, right=True) - torch.searchsorted(keys, wanted)
