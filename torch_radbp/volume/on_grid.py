"""What volumes have in common whose values stand on a grid."""

from __future__ import annotations

from itertools import product

import torch
from torch import Tensor

from torch_radbp.interface.volume import VolumeFunction
from torch_radbp.tensors.interleaved import columns_of_rows
from torch_radbp.tensors.vec import Vec3
from torch_radbp.transforms import matrix_inverse, transform_points
from torch_radbp.volume.grid import GridKind, GridTable


class OnGrid(VolumeFunction):
    """A volume of values on a grid in the unit cube, which `from_unit_cube` places in the world."""

    to_world: Tensor

    def kind(self) -> GridKind:
        return GridKind("trilinear", "clamp")

    def table(self, dtype: torch.dtype | None = None, device: torch.device | None = None) -> GridTable:
        values = self.samples()
        rows = values.to(dtype=dtype, device=device).reshape(-1, values.shape[3])
        size = tuple(torch.tensor([count], dtype=torch.int32, device=rows.device) for count in values.shape[2::-1])
        to_local = matrix_inverse(self.from_unit_cube()).to(rows)[:3]
        return GridTable(columns_of_rows(rows), size, tuple(
            (Vec3.of(row[None, :3]), row[3:].clone()) for row in to_local.unbind()))

    def cells(self) -> tuple[Tensor | None, Tensor]:
        values = self.samples().detach()
        to_local = matrix_inverse(self.from_unit_cube()).to(values)[:3]
        if self.kind().wrap_mode != "clamp":
            return None, to_local
        return values.movedim(3, 0), to_local

    def corners(self) -> Tensor:
        unit = torch.tensor(list(product((0.0, 1.0), repeat=3)), dtype=torch.float64, device=self.to_world.device)
        return transform_points(self.from_unit_cube(), unit).to(self.to_world.dtype)

    def from_unit_cube(self) -> Tensor:
        """(4, 4) the transform from the unit cube to the world, float64."""
        return self.to_world.double()
