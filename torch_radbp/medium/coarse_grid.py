"""A coarse grid over a volume with bounds of the values in each of its cells, and rays through it."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import max_pool3d

from torch_radbp.interface.volume import VolumeFunction
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.vec import TINY, Ray, Vec3, dot

COARSER = 8  # cells of the volume to a cell of the coarse grid, along each axis
NUDGE = 1e-3  # by which a ray is in the next cell when it is at the border, in cells; bounds hold as far beyond borders
ABOVE, BELOW = 1.0 + 1e-5, 1.0 - 1e-5  # over the largest value and the least, against rounding


class CoarseGrid(NamedTuple):
    """A grid of K cells, x fastest, with bounds of a volume's values in each; other columns have one entry."""

    bound: Tensor  # (K,) no value in the cell is larger
    least: Tensor  # (K,) or smaller
    size: tuple[Tensor, Tensor, Tensor]  # int32, along x, y and z
    to_cells: tuple[tuple[Vec3, Tensor], ...]  # the rows of the transform from the world, with its shift; in cells
    low: Vec3  # corners of the box in the world that the volume fills
    high: Vec3


def coarse_grid(volume: VolumeFunction) -> CoarseGrid:
    """Builds a grid of some larger cells over a volume, with bounds of its values in each; detached."""
    with torch.no_grad():
        bound, least, to_unit = bounds_of(volume)
        size = bound.shape[::-1]
        corners = volume.corners().to(bound)
        low, high = (Vec3.of(each[None]) for each in (corners.amin(0), corners.amax(0)))
        x, y, z = (torch.tensor([count], dtype=torch.int32, device=bound.device) for count in size)
        to_cells = to_unit * to_unit.new_tensor(size)[:, None]
        rows = tuple((Vec3.of(row[None, :3]), row[3:].clone()) for row in to_cells.unbind())
        return CoarseGrid(bound.reshape(-1) * ABOVE, least.reshape(-1) * BELOW, (x, y, z), rows, low, high)


def bounds_of(volume: VolumeFunction) -> tuple[Tensor, Tensor, Tensor]:
    """The largest and the least value in each coarse cell, (Z, Y, X), and the (3, 4) transform from the world to the unit
    cube that the grid fills."""
    cells, to_unit = volume.cells()
    if cells is None:
        largest, least = volume.extremes()
        return largest.reshape(1, 1, 1), least.reshape(1, 1, 1), to_unit
    # Those of the cells between whose centres points of a coarse cell are, a half and the nudge beyond its borders.
    bound, least = largest_nearby(cells).amax(0), least_nearby(cells).amin(0)
    scale = torch.tensor([count / (COARSER * of) for count, of in zip(cells.shape[1:], bound.shape)]).flip(0)
    return bound, least, to_unit * scale.to(to_unit)[:, None]


def largest_nearby(cells: Tensor) -> Tensor:
    """The largest value in and beside each coarse cell, of (C, Z, Y, X) fine cells."""
    return max_pool3d(cells[:, None], COARSER + 2, stride=COARSER, padding=1, ceil_mode=True)[:, 0]


def least_nearby(cells: Tensor) -> Tensor:
    """The least value in and beside each coarse cell, of (C, Z, Y, X) fine cells, by layers, as pooling finds only the
    largest."""
    layers = [cells[:, max(0, first - 1):first + COARSER + 1] for first in range(0, cells.shape[1], COARSER)]
    return -torch.cat([max_pool3d(-layer[:, None], (layer.shape[1], COARSER + 2, COARSER + 2), stride=COARSER,
                                  padding=(0, 1, 1), ceil_mode=True)[:, 0] for layer in layers], 1)


def cell_of(grid: CoarseGrid, ray: Ray, t: Tensor) -> Tensor:
    """The cells of the grid in which rays are at distances t, or just ahead of there, (N,) int32."""
    size, place, change = in_cells(grid, ray, t)
    x, y, z = (cell_along(at, d, count).to(torch.int32) for at, d, count in zip(place, change, size))
    return (z * size[1] + y) * size[0] + x


def distance_to_next_cell(grid: CoarseGrid, ray: Ray, t: Tensor) -> Tensor:
    """How far rays at distances t are from leaving their cell (see `cell_of`), (N,); infinite: they never leave it."""
    size, place, change = in_cells(grid, ray, t)
    nearest = torch.full_like(t, torch.inf)
    for at, d, count in zip(place, change, size):
        border = cell_along(at, d, count) + (d > 0).to(at.dtype)
        # Cells at the rim have no border there, but go on.
        leaves = (d.abs() > TINY) & (border > 0) & (border < count.to(at.dtype))
        speed = torch.where(leaves, d, 1.0)
        reach = torch.maximum((border - at) / speed, NUDGE / speed.abs())
        nearest = torch.where(leaves, torch.minimum(nearest, reach), nearest)
    return nearest


def cell_along(place: Tensor, change: Tensor, count: Tensor) -> Tensor:
    """The index, along one axis, of the cell in which rays are, or just ahead of there, (N,) as float."""
    ahead = torch.floor(place + torch.copysign(torch.full_like(place, NUDGE), change))
    return torch.minimum(ahead.clamp_min(0.0), (count - 1).to(place.dtype))


def in_cells(grid: CoarseGrid, ray: Ray, t: Tensor) -> tuple[tuple[Tensor, ...], list[Tensor], list[Tensor]]:
    """The size of the grid, the positions of rays at distances t in units of cells, and the change of these with t."""
    only = torch.zeros_like(t, dtype=torch.int32)
    size, to_cells = lookup(grid.size, only), lookup(grid.to_cells, only)
    change = [dot(row, ray.d) for row, _ in to_cells]
    place = [dot(row, ray.o) + shift + d * t for (row, shift), d in zip(to_cells, change)]
    return size, place, change
