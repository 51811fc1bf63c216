"""What is known of surfaces before paths meet them: where they go on smoothly, and where their textures jump."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.edge_places import jump_of_creases
from torch_radbp.boundary.geometry import geometry_of, in_world
from torch_radbp.boundary.outline import Outline
from torch_radbp.plugin.jump_lines import JumpLines
from torch_radbp.raycast.protocol import Hit
from torch_radbp.scene.interaction import at_corners
from torch_radbp.scene.tensors import SceneTensors
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.vec import interpolated


class LineTable(NamedTuple):
    """The lines of textures, as of `JumpLines`; (K S,) float64 each, of K shapes the first of each, then the second, ..."""

    x: Tensor
    y: Tensor
    z: Tensor
    first: Tensor
    last: Tensor
    shape: Tensor  # (T,) int64 of each triangle, among the K
    count: int  # K
    most: int  # S

    def row(self, prim: Tensor, slot: Tensor | int) -> Tensor:
        """Which lines triangles have, (N,) int64."""
        return slot * self.count + self.shape.index_select(0, prim.clamp_min(0))


class Surfaces(NamedTuple):
    """The surfaces of a scene; detached."""

    continues: Tensor  # (3 T,) int32, from `continued`
    lines: LineTable | None  # None: no texture jumps


def continued(scene: SceneTensors, meshes: Sequence[Outline]) -> Tensor:
    """For each side of the triangles, three each, opposite their corners, the triangle on which the surface goes on without
    a jump; -1: it does not. (3 T,) int32.

    Args:
        scene: detached.
        meshes: the edges of all of them, in the frames of their vertices.
    """
    geometry = geometry_of(scene)
    found = torch.full((3 * len(scene.triangles.material),), -1, dtype=torch.int32, device=scene.device)
    for mesh in meshes:
        edges = mesh.edges
        a, b, *opposite = in_world(geometry, (edges.a, edges.b, *edges.opposite[:2]), None)
        smooth = (edges.count == 2) & (jump_of_creases(mesh, a, b, opposite) == 0)
        one, other = (corner[smooth] for corner in edges.corner[:2])
        for here, there in ((one, other), (other, one)):
            found[here.long()] = torch.div(there, 3, rounding_mode="floor")
    return found


def line_table(lines: Sequence[tuple[JumpLines, ...]], sizes: Sequence[int], device: torch.device) -> LineTable | None:
    """The lines of each shape's textures, of so many triangles each; None: there are none."""
    most = max(map(len, lines), default=0)
    if not most:
        return None
    nowhere = JumpLines(0.0, 0.0, 0.5, 0.0, 0.0)
    slots = [own[slot] if slot < len(own) else nowhere for slot in range(most) for own in lines]
    columns = [torch.tensor(column, dtype=torch.float64, device=device) for column in zip(*slots)]
    return LineTable(*columns, torch.repeat_interleave(torch.tensor(sizes, device=device)), len(lines), most)


def cells_met(scene: SceneTensors, lines: LineTable | None, hit: Hit) -> tuple[Tensor, ...]:
    """Between which lines textures are met, by the number of the last line of each kind, (N,) float64."""
    if lines is None or scene.triangles.vertices.uv is None:
        return ()
    rows = [lines.row(hit.prim, slot) for slot in range(lines.most)]
    return tuple(torch.minimum(torch.maximum(torch.floor(level_of_line(scene, lines, hit.prim, row, hit.u, hit.v)),
                                             lines.first[row] - 1.0), lines.last[row]) for row in rows)


def level_of_line(scene: SceneTensors, lines: LineTable, prim: Tensor, row: Tensor, u: Tensor, v: Tensor) -> Tensor:
    """The number that is an integer on lines, (N,) float64, attached to the surface coordinates.

    Args:
        prim: (N,) int32, triangles.
        row: (N,) int64, of the table.
        u, v: (N,) where on the triangles, barycentric, attached.
    """
    corners = lookup(scene.triangles.corners, prim.clamp_min(0))
    uv = interpolated(at_corners(scene.triangles.vertices.uv, corners), u, v)
    return lines.x[row] * uv.x.double() + lines.y[row] * uv.y.double() + lines.z[row]
