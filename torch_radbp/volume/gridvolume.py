"""The plugin of values on a grid."""

from __future__ import annotations

from math import inf

import torch
from torch import Tensor

from torch_radbp.formats.nanovdb import CONVERT, read_nanovdb
from torch_radbp.formats.volume import UNIT_BOX, read_volume
from torch_radbp.plugin import Filename, Matrix4, boolean, finite, nearest, register
from torch_radbp.plugin.domain import LARGEST_AMOUNT, Domain
from torch_radbp.transforms import affine
from torch_radbp.volume.grid import GridKind
from torch_radbp.volume.on_grid import OnGrid

FILTERS = ("trilinear", "nearest")
WRAP_MODES = ("clamp", "repeat", "mirror")
CHANNELS = (1, 3, 6)
LARGEST_GRID = 2**31 - 1  # cells, which are numbered in int32


@register("volume", "gridvolume")
class GridVolume(OnGrid):
    """Values on a grid in the unit cube [0, 1]^3 under `to_world`, between the centres of its cells interpolated.

    Parameters: `data`, (Z, Y, X, C). Derivatives: with respect to it, and through the point that is read to whatever moves
    it. `to_world` is no parameter. Reference: the documentation of Mitsuba 3, "Grid-based volume data source".

    Args:
        filename: in Mitsuba's format .vol, or of NanoVDB, .nvdb, float32, one or three at a point. Either this, `grid` or
            `data`.
        grid, data: (Z, Y, X) or (Z, Y, X, C) values; both names mean the same. C is 1, 3 (linear RGB), or 6 of an `sggx`.
        use_grid_bbox: place the grid in the box that the file names, instead of in the unit cube. One of a .nvdb stands
            where the map of the file places it, whatever this is.
        filter_type: trilinear or nearest.
        wrap_mode: what is read outside of the cube: clamp, the nearest values in it; repeat or mirror.
        raw: that values are no colours. Of no effect here, where colours are linear.
        to_world: the pose of the cube, or of the box, or of the world of a .nvdb.
        accel: whether Mitsuba reads it by the texture units of a GPU. Of no effect here.
        max_value: the bound of values that Mitsuba uses. Of no effect here, where it is the largest entry.
        grid_name: of the grid in a .nvdb; it need not be told of the only one.

    Raises:
        ValueError: on unknown modes, a wrong shape, and values that are not finite, or negative, but of 6 channels.
    """

    grid = grid_name = None  # resolved into `data`

    def __init__(self, *, filename: Filename | None = None, grid: Tensor | None = None, data: Tensor | None = None,
                 use_grid_bbox: bool = False, filter_type: str = "trilinear", wrap_mode: str = "clamp", raw: bool = False,
                 to_world: Matrix4 | None = None, accel: bool = True, max_value: float | None = None,
                 grid_name: str | None = None):
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
        sparse = str(filename).lower().endswith(".nvdb")
        if grid_name is not None and not sparse:
            raise ValueError(f"grid_name {grid_name!r} needs the filename of a .nvdb: others have one grid")
        if str(filename).lower().endswith(".vdb"):
            raise ValueError(f"{filename}: OpenVDB files are not read; {CONVERT}")
        self.filename, self.filter_type, self.wrap_mode = filename, filter_type, wrap_mode
        self.use_grid_bbox, self.raw, self.accel = boolean("use_grid_bbox", use_grid_bbox) and not sparse, raw, accel
        self.max_value = max_value
        (name, values), = given.items()
        self.box: tuple[float, ...] = UNIT_BOX
        pose = affine("to_world", to_world)
        if filename is not None and sparse:
            found = read_nanovdb(filename, grid_name)
            name, values = "data", torch.from_numpy(found.values)
            pose = affine("to_world", pose @ torch.from_numpy(found.to_world).to(pose))
        elif filename is not None:
            file = read_volume(filename, CHANNELS)
            name, values, self.box = "data", torch.from_numpy(file.values), file.box
        if self.use_grid_bbox and not all(0 < high - low < inf for low, high in zip(self.box, self.box[3:])):
            raise ValueError(f"use_grid_bbox: the box of {filename} must be finite and not empty, got {self.box}")
        values = finite(name, values).to(torch.get_default_dtype())
        values = values[..., None] if values.ndim == 3 else values
        if values.ndim != 4 or values.shape[3] not in CHANNELS or not 0 < values[..., 0].numel() <= LARGEST_GRID:
            raise ValueError(f"{name} of a gridvolume must have shape (Z, Y, X) or (Z, Y, X, C), C 1, 3 or 6, got "
                             f"{tuple(values.shape)}")
        self.signed = values.shape[3] == 6
        self.freeze("data", values)
        self.register_buffer("to_world", pose.to(torch.get_default_dtype()))

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

    def from_unit_cube(self) -> Tensor:
        """(4, 4) the transform from the unit cube to the world, float64."""
        pose = self.to_world.double()
        if not self.use_grid_bbox:
            return pose
        low, high = pose.new_tensor(self.box).view(2, 3)
        into_box = torch.diag(torch.cat([high - low, pose.new_ones(1)]))
        into_box[:3, 3] = low
        return pose @ into_box
