"""A surface given by signed distances on a grid."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from torch_radbp.formats.volume import read_volume
from torch_radbp.plugin import BSDF, Emitter, Filename, Matrix4, Medium, finite, nearest, register
from torch_radbp.plugin.domain import LARGEST_AMOUNT, POSE, Domain
from torch_radbp.shape.surface import Surface, Triangles, turned
from torch_radbp.shape.zero_set import Net, check_grid, smooth_normal, unit_vector, vertices, voxel_gradient, zero_net
from torch_radbp.tensors.differentiated import primal
from torch_radbp.transforms import mirrors, transform, transform_normals, transform_points

GRID = Domain(shapes=(("Z", "Y", "X", 1),), limit=LARGEST_AMOUNT)
NORMALS = ("analytic", "smooth")


@register("shape", "sdfgrid")
class SDFGrid(Surface):
    """The zero set of the trilinear interpolant of a grid of signed distances, in the unit cube [0, 1]^3 under `to_world`.

    Parameters: `grid` (Z, Y, X, 1), `to_world` (4, 4). Derivatives: with respect to both.

    Tessellated by marching cubes, see `torch_radbp.shape.zero_set`: vertices are on the surface exactly, with at least 60
    cells to the longest side of the cube. The triangles are found anew when the grid has changed; a mirroring `to_world`
    keeps the normals outwards. As in Mitsuba there are no coordinates uv: textures are read at (0, 0). It may carry an
    emitter, which Mitsuba cannot sample. Mitsuba 3.9.1 exchanges the sizes of voxels along x and z, so that its image is
    another unless they are equal; loses the surface where `to_world` turns it; and bends smooth normals at the upper borders
    of the grid.

    Args:
        filename: a volume of one channel, such as Mitsuba's .vol. Either this or `grid`.
        grid: (Z, Y, X, 1) distances, negative inside; the first and last are on the faces of the cube, where the surface
            ends if it is cut there.
        to_world: the pose of the cube; it may turn and mirror it.
        normals: how it is shaded: smooth, with normals that are continuous across voxels; or analytic, with the gradient
            of the interpolant, which is not. At vertices exactly, between them interpolated.

    Raises:
        ValueError: unless exactly one of `filename` and `grid` is given, with values of both signs.
    """

    def __init__(self, *, filename: Filename | None = None, grid: Tensor | None = None, normals: str = "smooth",
                 to_world: Matrix4 | None = None, bsdf: BSDF | None = None, emitter: Emitter | None = None,
                 interior: Medium | None = None, exterior: Medium | None = None):
        super().__init__(bsdf=bsdf, emitter=emitter, interior=interior, exterior=exterior)
        if normals not in NORMALS:
            raise ValueError(f"normals {normals!r} is not known; {nearest(normals, NORMALS)}")
        if (filename is None) == (grid is None):
            raise ValueError("an sdfgrid needs either filename or grid, and not both")
        if filename is not None:
            grid = torch.from_numpy(read_volume(filename).values)
        self.filename, self.normals = filename, normals
        self.freeze("grid", finite("grid", grid).to(torch.get_default_dtype()))
        check_grid("grid", self.grid.detach()[..., 0])
        self.freeze("to_world", transform("to_world", to_world))

    def domains(self) -> dict[str, Domain]:
        return {"grid": GRID, "to_world": POSE}

    def connections(self) -> tuple[Callable, tuple[Any, ...]]:
        return net_of, (self.grid, self.normals == "analytic")

    @property
    def faces(self) -> Tensor:
        """(F, 3) int64, the corners of the triangles; marching cubes run whenever it is read."""
        return net_of(primal(self.grid), self.normals == "analytic").faces

    def triangles(self, net: Net | None = None) -> Triangles:
        if net is None:
            net = net_of(primal(self.grid), self.normals == "analytic")
        values = self.grid[..., 0]
        cell, corners = vertices(values, net)
        size = torch.tensor(values.shape, dtype=values.dtype, device=values.device).flip(0) - 1.0
        points = (net.voxel.to(values.dtype) + cell.place.stack()) / size
        if self.normals == "smooth":
            normals = smooth_normal(values, cell, corners)
        else:
            normals = unit_vector(voxel_gradient(values, cell, corners))
        faces = turned(net.faces) if mirrors(self.to_world) else net.faces
        return Triangles(transform_points(self.to_world, points), faces, transform_normals(self.to_world, normals.stack()),
                         None)


def net_of(grid: Tensor, of_voxels: bool) -> Net:
    """The marching-cubes net of a grid's zero set, (Z, Y, X, 1), detached; see `zero_net`."""
    return zero_net(grid[..., 0], of_voxels)
