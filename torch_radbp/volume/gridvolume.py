"""Values on a grid."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from math import inf
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.formats.volume import UNIT_BOX, read_volume
from torch_radbp.interface.volume import VolumeFunction, VolumeKind
from torch_radbp.plugin import Filename, Matrix4, boolean, finite, nearest, register
from torch_radbp.plugin.domain import LARGEST_AMOUNT, Domain
from torch_radbp.tensors.interleaved import columns_of_rows
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.vec import Vec3, dot
from torch_radbp.transforms import affine, transform_points

FILTERS = ("trilinear", "nearest")
WRAP_MODES = ("clamp", "repeat", "mirror")
CHANNELS = (1, 3, 6)
LARGEST_GRID = 2**31 - 1  # cells, which are numbered in int32


class GridTable(NamedTuple):
    """A grid of K cells; the other columns have one entry."""

    cells: tuple[Tensor, ...]  # (K,) for each channel, x fastest; attached
    size: tuple[Tensor, Tensor, Tensor]  # int32, along x, y and z
    to_local: tuple[tuple[Vec3, Tensor], ...]  # the rows of the transform from the world into the unit cube, with its shift


@dataclass(frozen=True)
class GridKind(VolumeKind):
    """Interpolates between the centres of cells, or reads the cell that a point is in."""

    filter_type: str
    wrap_mode: str

    def values(self, table: GridTable, p: Vec3) -> tuple[Tensor, ...]:
        only = torch.zeros_like(p.x, dtype=torch.int32)
        size, to_local = lookup(table.size, only), lookup(table.to_local, only)
        place = [(dot(row, p) + shift) * count for (row, shift), count in zip(to_local, size)]
        if self.filter_type == "nearest":
            x, y, z = (self.inside(torch.floor(at.detach()), count) for at, count in zip(place, size))
            return lookup(table.cells, (z * size[1] + y) * size[0] + x)
        (x, fx), (y, fy), (z, fz) = (self.neighbours(at - 0.5, count) for at, count in zip(place, size))
        rows = [(k * size[1] + j) * size[0] for k in z for j in y]
        edges = [between(lookup(table.cells, row + x[0]), lookup(table.cells, row + x[1]), fx) for row in rows]
        return between(between(edges[0], edges[1], fy), between(edges[2], edges[3], fy), fz)

    def neighbours(self, place: Tensor, count: Tensor) -> tuple[tuple[Tensor, Tensor], Tensor]:
        """The two cells around a place along one axis, and how far it is between their centres, attached."""
        if self.wrap_mode == "clamp":  # also places so far away that they are no integers
            place = torch.minimum(place.clamp_min(0.0), (count - 1).to(place.dtype))
        first = torch.floor(place.detach())
        return (self.inside(first, count), self.inside(first + 1.0, count)), place - first

    def inside(self, place: Tensor, count: Tensor) -> Tensor:
        """The integers, int32, of [0, count) for those anywhere, as float, that the wrap mode maps to them."""
        if self.wrap_mode == "clamp":
            return torch.minimum(torch.minimum(place, count.to(place.dtype)).to(torch.int32).clamp_min(0), count - 1)
        cell = place.to(torch.int32)
        if self.wrap_mode == "repeat":
            return torch.remainder(cell, count)
        folded = torch.remainder(cell, 2 * count)
        return torch.minimum(folded, 2 * count - 1 - folded)


def between(first: tuple[Tensor, ...], second: tuple[Tensor, ...], share: Tensor) -> tuple[Tensor, ...]:
    """Interpolates linearly between the channels of two places."""
    return tuple(a + (b - a) * share for a, b in zip(first, second))


@register("volume", "gridvolume")
class GridVolume(VolumeFunction):
    """Values on a grid in the unit cube [0, 1]^3 under `to_world`, between the centres of its cells interpolated.

    Parameters: `data`, (Z, Y, X, C). Derivatives: with respect to it, and through the point that is read to whatever moves
    it. `to_world` is no parameter. Reference: the documentation of Mitsuba 3, "Grid-based volume data source".

    Args:
        filename: in Mitsuba's format .vol. Either this, `grid` or `data`.
        grid, data: (Z, Y, X) or (Z, Y, X, C) values; both names mean the same. C is 1, 3 (linear RGB), or 6 of an `sggx`.
        use_grid_bbox: place the grid in the box that the file names, instead of in the unit cube.
        filter_type: trilinear or nearest.
        wrap_mode: what is read outside of the cube: clamp, the nearest values in it; repeat or mirror.
        raw: that values are no colours. Of no effect here, where colours are linear.
        to_world: the pose of the cube, or of the box.
        accel: whether Mitsuba reads it by the texture units of a GPU. Of no effect here.
        max_value: the bound of values that Mitsuba uses. Of no effect here, where it is the largest entry.

    Raises:
        ValueError: on unknown modes, a wrong shape, and values that are not finite, or negative, but of 6 channels.
    """

    grid = None  # resolved into `data`

    def __init__(self, *, filename: Filename | None = None, grid: Tensor | None = None, data: Tensor | None = None,
                 use_grid_bbox: bool = False, filter_type: str = "trilinear", wrap_mode: str = "clamp", raw: bool = False,
                 to_world: Matrix4 | None = None, accel: bool = True, max_value: float | None = None):
        super().__init__()
        for name, value, supported in (("filter_type", filter_type, FILTERS), ("wrap_mode", wrap_mode, WRAP_MODES)):
            if value not in supported:
                raise ValueError(f"{name} {value!r} is not known; {nearest(value, supported)}")
        given = {"filename": filename, "grid": grid, "data": data}
        given = {name: value for name, value in given.items() if value is not None}
        if len(given) != 1:
            raise ValueError(f"a gridvolume needs one of filename, grid and data, got {' and '.join(given) or 'none'}")
        if use_grid_bbox and filename is None:
            raise ValueError("use_grid_bbox needs a filename: only files have a box; give to_world")
        self.filename, self.filter_type, self.wrap_mode = filename, filter_type, wrap_mode
        self.use_grid_bbox, self.raw, self.accel = boolean("use_grid_bbox", use_grid_bbox), raw, accel
        self.max_value = max_value
        (name, values), = given.items()
        self.box = UNIT_BOX
        if filename is not None:
            file = read_volume(filename, CHANNELS)
            name, values, self.box = "data", torch.from_numpy(file.values), file.box
        if use_grid_bbox and not all(0 < high - low < inf for low, high in zip(self.box, self.box[3:])):
            raise ValueError(f"use_grid_bbox: the box of {filename} must be finite and not empty, got {self.box}")
        values = finite(name, values).to(torch.get_default_dtype())
        values = values[..., None] if values.ndim == 3 else values
        if values.ndim != 4 or values.shape[3] not in CHANNELS or not 0 < values[..., 0].numel() <= LARGEST_GRID:
            raise ValueError(f"{name} of a gridvolume must have shape (Z, Y, X) or (Z, Y, X, C), C 1, 3 or 6, got "
                             f"{tuple(values.shape)}")
        self.signed = values.shape[3] == 6
        self.freeze("data", values)
        self.register_buffer("to_world", affine("to_world", to_world).to(torch.get_default_dtype()))

    def domains(self) -> dict[str, Domain]:
        shape = (("Z", "Y", "X", 6),) if self.signed else (("Z", "Y", "X", 1), ("Z", "Y", "X", 3))
        return {"data": Domain(shapes=shape, limit=LARGEST_AMOUNT, **{} if self.signed else {"low": 0.0, "floor": 0.0})}

    def kind(self) -> GridKind:
        return GridKind(self.filter_type, self.wrap_mode)

    def channels(self) -> int:
        return self.data.shape[3]

    def entries(self) -> dict[str, Tensor]:
        return {"data": self.data}

    def table(self, dtype: torch.dtype | None = None, device: torch.device | None = None) -> GridTable:
        rows = self.data.to(dtype=dtype, device=device).reshape(-1, self.channels())
        size = tuple(torch.tensor([count], dtype=torch.int32, device=rows.device) for count in self.data.shape[2::-1])
        to_local = torch.linalg.inv(self.from_unit_cube()).to(rows)[:3]
        return GridTable(columns_of_rows(rows), size, tuple(
            (Vec3.of(row[None, :3]), row[3:].clone()) for row in to_local.unbind()))

    def corners(self) -> Tensor:
        unit = torch.tensor(list(product((0.0, 1.0), repeat=3)), dtype=torch.float64, device=self.data.device)
        return transform_points(self.from_unit_cube(), unit).to(self.data.dtype)

    def from_unit_cube(self) -> Tensor:
        """(4, 4) the transform from the unit cube to the world, float64."""
        pose = self.to_world.double()
        if not self.use_grid_bbox:
            return pose
        low, high = pose.new_tensor(self.box).view(2, 3)
        into_box = torch.diag(torch.cat([high - low, pose.new_ones(1)]))
        into_box[:3, 3] = low
        return pose @ into_box
