"""Tables of surfaces for searches: which triangles continue smoothly, and where textures are discontinuous."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple
from weakref import WeakKeyDictionary

import torch
from torch import Tensor

from torch_radbp.boundary.curve.edge_places import jump_of_creases
from torch_radbp.boundary.curve.geometry import Geometry, NormalsOnly, geometry_of, in_world
from torch_radbp.boundary.curve.outline import Outline
from torch_radbp.boundary.curve.term import offsets
from torch_radbp.call.render_call import RenderCall
from torch_radbp.plugin.jump_lines import JumpLines
from torch_radbp.raycast.caster_cache import same_values
from torch_radbp.raycast.protocol import Hit
from torch_radbp.scene.modules.scene import Scene
from torch_radbp.scene.tables.placement import for_lanes
from torch_radbp.scene.tables.scene_tensors import SceneTensors, TriangleTable
from torch_radbp.scene.tables.triangle_corners import at_corners
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.stage import stage
from torch_radbp.tensors.vec import Vec3, interpolated


class LineTable(NamedTuple):
    """The lines x u + y v + z = integer at which textures of K shapes jump, from a `first` integer to a `last` one.

    S of them for each shape, in (K S,) float64 tensors: the first of each shape, then the second, ...
    """

    x: Tensor
    y: Tensor
    z: Tensor
    first: Tensor
    last: Tensor
    shape: Tensor  # (T,) int64, index of each triangle's shape among the K
    count: int  # K
    most: int  # S

    def row(self, prim: Tensor, slot: Tensor | int) -> Tensor:
        """The rows of the table with line number `slot` of the triangles' shapes, (N,) int64."""
        return slot * self.count + self.shape.index_select(0, prim.clamp_min(0))


class SmoothParts(NamedTuple):
    """Which triangles of a scene, T, continue each other smoothly."""

    continues: Tensor  # (3 T,) int32, for each side, by opposite corner, the next triangle if the surface is smooth
    part: Tensor  # (T,) int32, equal for triangles of one smooth surface


class Surfaces(NamedTuple):
    """The surfaces of a scene, used in place of `SceneTensors` by stages; detached."""

    triangles: TriangleTable
    layout: NormalsOnly
    smooth: SmoothParts
    lines: LineTable | None  # None: no texture is discontinuous


class CachedSmoothParts(NamedTuple):
    """The smooth parts of a scene, cached together with what they depend on."""

    vertices: Vec3
    meshes: list[Outline]
    smooth_edges: list[Tensor]  # (E,) bool of each mesh: surfaces continue smoothly across them
    smooth: SmoothParts


KNOWN: WeakKeyDictionary[Scene, CachedSmoothParts] = WeakKeyDictionary()


def surfaces_of(call: RenderCall, meshes: list[Outline], lines: LineTable | None) -> Surfaces:
    """The triangles, smooth parts and texture lines of a call's scene, for searches.

    Smooth parts are cached while the same edges are smooth, even if vertices move.

    Args:
        call: detached.
        meshes: the edges of all meshes, in the frames of their vertices.
        lines: of textures.
    """
    triangles, known = call.scene.triangles, KNOWN.get(call.module)
    same_meshes = (known is not None and len(meshes) == len(known.meshes)
                   and all(own is old for own, old in zip(meshes, known.meshes)))
    if not same_meshes or not all(map(same_values, known.vertices, triangles.vertices.p)):
        geometry = geometry_of(call.scene)
        smooth_edges = [call.stages(goes_on)(geometry, mesh) for mesh in meshes]
        smooth = known.smooth if same_meshes and all(map(torch.equal, smooth_edges, known.smooth_edges)) else (
            smooth_parts(meshes, smooth_edges, len(triangles.material), call.scene.device))
        known = CachedSmoothParts(triangles.vertices.p, meshes, smooth_edges, smooth)
        KNOWN[call.module] = known
    vertices = triangles.vertices._replace(attributes=(), uv=None if lines is None else triangles.vertices.uv)
    triangles = triangles._replace(vertices=vertices, clearance=None, along=None, emitter=None, balls=None, attributes=(),
                                   numbers=None, instances=for_lanes(triangles.instances))
    return Surfaces(triangles, NormalsOnly(call.scene.layout.shading_normals), known.smooth, lines)


def smooth_parts(meshes: Sequence[Outline], smooth_edges: Sequence[Tensor], count: int, device: torch.device) -> SmoothParts:
    """Finds which triangles belong to one smooth surface.

    Args:
        meshes: the edges of all meshes.
        smooth_edges: (E,) bool for each mesh: surfaces continue smoothly across the edge.
        count: the number of triangles of the scene.
        device: of the scene.
    """
    continues = torch.full((3 * count,), -1, dtype=torch.int32, device=device)
    joints = [torch.zeros(2, 0, dtype=torch.int64, device=device)]
    for mesh, smooth in zip(meshes, smooth_edges):
        edges = smooth.nonzero().squeeze(1)
        one, other = (corner[edges].long() for corner in mesh.edges.corner[:2])
        faces = torch.div(one, 3, rounding_mode="floor"), torch.div(other, 3, rounding_mode="floor")
        continues[one], continues[other] = faces[1].int(), faces[0].int()
        joints.append(torch.stack(faces))
    return SmoothParts(continues, connected(torch.cat(joints, 1), count).int())


@stage("geometry")
def goes_on(geometry: Geometry, outline: Outline) -> Tensor:
    """(E,) bool: edges across which the surface continues smoothly."""
    edges = outline.edges
    a, b, *opposite = in_world(geometry, (edges.a, edges.b, *edges.opposite[:2]), None)
    return (edges.count == 2) & (jump_of_creases(outline, a, b, opposite) == 0.0)


def connected(joints: Tensor, count: int) -> Tensor:
    """For each of `count` items the least number in its connected component; `joints`: (2, J) int64 pairs."""
    label = torch.arange(count, device=joints.device)
    while True:
        ends = label[joints[0]], label[joints[1]]
        least = torch.minimum(*ends)
        found = label.clone()
        for end in ends:
            found.scatter_reduce_(0, end, least, "amin")
        found = found[found]
        if torch.equal(found, label):
            return label
        label = found


def line_table(lines: Sequence[tuple[JumpLines, ...]], sizes: Sequence[int], device: torch.device) -> LineTable | None:
    """The table of all shapes' texture lines; None: there are none."""
    most = max(map(len, lines), default=0)
    if not most:
        return None
    nowhere = JumpLines(0.0, 0.0, 0.5, 0.0, 0.0)
    slots = [own[slot] if slot < len(own) else nowhere for slot in range(most) for own in lines]
    x, y, _, first, last = (torch.tensor(column, dtype=torch.float64, device=device) for column in list(zip(*slots))[:5])
    shape = torch.repeat_interleave(torch.tensor(sizes, device=device))
    return LineTable(x, y, offsets(slots, device), first, last, shape, len(lines), most)


def cells_met(surfaces: Surfaces, hit: Hit) -> tuple[Tensor, ...]:
    """The cells between texture lines in which hits lie: the number of the last line of each kind, (N,) float64."""
    lines = surfaces.lines
    if lines is None or surfaces.triangles.vertices.uv is None:
        return ()
    rows = [lines.row(hit.prim, slot) for slot in range(lines.most)]
    return tuple(torch.minimum(torch.maximum(torch.floor(level_of_line(surfaces, lines, hit.prim, row, hit.u, hit.v)),
                                             lookup(lines.first, row) - 1.0), lookup(lines.last, row)) for row in rows)


def level_of_line(scene: SceneTensors | Surfaces, lines: LineTable, prim: Tensor, row: Tensor, u: Tensor,
                  v: Tensor) -> Tensor:
    """The value x u + y v + z that is an integer on texture lines, (N,) float64, attached to u and v.

    Args:
        prim: (N,) int32, triangles.
        row: (N,) int64, of the table.
        u, v: (N,) barycentric coordinates on the triangles, attached.
    """
    corners = lookup(scene.triangles.corners, prim.clamp_min(0))
    uv = interpolated(at_corners(scene.triangles.vertices.uv, corners), u, v)
    return lookup(lines.x, row) * uv.x.double() + lookup(lines.y, row) * uv.y.double() + lookup(lines.z, row)
