"""The plugin of values on a grid."""

from __future__ import annotations

from itertools import product
from math import inf

import torch
from torch import Tensor

from torch_radbp.formats.volume import UNIT_BOX, read_volume
from torch_radbp.interface.volume import VolumeFunction
from torch_radbp.plugin import Filename, Matrix4, boolean, finite, nearest, register
from torch_radbp.plugin.domain import LARGEST_AMOUNT, Domain
from torch_radbp.tensors.interleaved import columns_of_rows
from torch_radbp.tensors.vec import Vec3
from torch_radbp.transforms import affine, transform_points
from torch_radbp.volume.grid import GridKind, GridTable

FILTERS = ("trilinear", "nearest")
WRAP_MODES = ("clamp", "repeat", "mirror")
CHANNELS = (1, 3, 6)
LARGEST_GRID = 2**31 - 1  # cells, which are numbered in int32


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
        self.box: tuple[float, ...] = UNIT_BOX
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
        least = -inf if self.signed else 0.0
        return {"data": Domain(shapes=shape, low=least, limit=LARGEST_AMOUNT, floor=least)}

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

    def cells(self) -> tuple[Tensor | None, Tensor]:
        to_local = torch.linalg.inv(self.from_unit_cube()).to(self.data)[:3]
        if self.wrap_mode != "clamp":
            return None, to_local
        data = self.data.detach()
        return (data[..., 0] if self.channels() == 1 else data.amax(3)), to_local  # a view takes no memory

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
