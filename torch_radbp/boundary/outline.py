"""The edges of triangle meshes at which an image may jump, in the world.

An image jumps at a silhouette, where a surface ends or turns away and another appears behind it, and at a crease, where two
surfaces meet that are shaded differently. Along all other edges, those inside of smoothly shaded surfaces and of planes, it
is continuous unless they are silhouettes.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.edges import Edges, edges_of
from torch_radbp.boundary.faces import Faces
from torch_radbp.boundary.faces import joined as joined_faces
from torch_radbp.boundary.places import Placed
from torch_radbp.boundary.rendering import Rendering
from torch_radbp.differentiated import detached
from torch_radbp.raycast.caster_cache import same
from torch_radbp.rendering.call.render_call import RenderCall
from torch_radbp.scene.placement import shown
from torch_radbp.scene.tensors import SceneTensors, TriangleTable
from torch_radbp.shape.placement import Instances
from torch_radbp.vec import Vec3, rows

COPLANAR = 1e-6  # half of the difference of unit normals, below which triangles lie in one plane
MOST_SHOWN = 1 << 20  # edges of instances of a group that are examined; of more instances some are picked at random


class Outline(NamedTuple):
    """E edges between U vertices in the world."""

    edges: Edges
    instance: Tensor | None  # (U,) int32 that shows each vertex, as hits count; None: the scene has none
    crease: Tensor  # (E,) in [0, 1], how much of a jump an edge may be that is no silhouette; 0: none
    share: Tensor  # (E,) probability with which an edge is among these

    def vertices(self, scene: SceneTensors, index: Tensor | None = None) -> Vec3:
        """Its vertices in the world, (U,), or those that `index` calls for; attached to the scene."""
        row = self.edges.vertex if index is None else self.edges.vertex[index]
        points = rows(scene.triangles.vertices.p, row)
        if self.instance is None:
            return points
        return shown(scene, Placed(self.instance if index is None else self.instance[index]), (points,))[0]


class Moving(NamedTuple):
    """What moves in the view of a camera."""

    shapes: tuple[bool, ...]  # each shape, those of groups last
    instances: tuple[bool, ...]  # each instance, as hits count but from 0


class Jumps(NamedTuple):
    """Where the image of a view may jump."""

    outline: Outline | None  # edges; None: there are none
    faces: Faces | None  # triangles inside of which it may


class OutlinedMesh(NamedTuple):
    """The edges of some triangles, and what else about them does not change while these do not move."""

    corners: tuple[Tensor, Tensor, Tensor]  # of all triangles of the scene
    smooth: Tensor | None  # of all triangles of the scene
    reads: tuple[bool, ...]  # whether the scene has normals and surface coordinates of vertices
    edges: Edges  # `corner` counts those of all triangles
    creases: Creases


class Creases(NamedTuple):
    """How much of a jump edges may be that are no silhouettes."""

    fixed: Tensor  # (E,) 1 where that is not known better; 0 where there is none, or where the normals of triangles tell
    flat: Tensor  # (P,) int64, the edges where they do: between triangles of one flat-shaded surface
    here: Tensor  # (P,) int64, one triangle there
    there: Tensor  # (P,) the other

    def jumps(self, n: Vec3) -> Tensor:
        """(E,) in [0, 1]; `n` (T,) the normals of the scene's triangles, of which half of the difference counts."""
        apart = 0.5 * torch.sqrt(sum((part[self.here] - part[self.there]) ** 2 for part in n))
        return self.fixed.to(apart.dtype).index_copy(0, self.flat, torch.where(apart > COPLANAR, apart, 0.0))


class Outlines:
    """Finds outlines, and remembers the edges of meshes whose triangles have not changed."""

    def __init__(self) -> None:
        self.known: dict[object, OutlinedMesh] = {}

    def of_views(self, rendering: Rendering, call: RenderCall, seed: int) -> list[Jumps]:
        """Where each view of a call may jump: at all shapes where the camera moves, at those that move where it does not.

        Args:
            rendering: the call's.
            call: of which something moves.
            seed: of the choice of instances.
        """
        scene, generator = detached(call.scene), torch.Generator("cpu").manual_seed(seed % (1 << 63))
        instances = rendering.moving_instances
        own = Moving(tuple(map(bool, rendering.movers)), instances)
        turning = own._replace(shapes=tuple(moves or bool(names) for moves, names in zip(own.shapes, rendering.turners)))
        everything = Moving(*((True,) * len(part) for part in own))
        wanted = [(everything,) * 2 if rendering.moving(sensor) else (own, turning) for sensor in rendering.sensors]
        sizes = rendering.sizes
        found = {pair: Jumps(self.of(scene, sizes, pair[0], generator), faces_of(scene, sizes, pair[1], generator))
                 for pair in dict.fromkeys(wanted)}
        return [found[pair] for pair in wanted]

    def of(self, scene: SceneTensors, counts: Sequence[int], moving: Moving, generator: torch.Generator) -> Outline | None:
        """The edges of all that moves; None: there are none.

        Args:
            scene: detached.
            counts: the number of triangles of each shape, those of groups last.
            moving: what does.
            generator: picks instances where there are too many; on the CPU.
        """
        triangles = scene.triangles
        instances = None if triangles.instances is None else triangles.instances.casting
        firsts = list(accumulate(counts, initial=0))
        own = firsts[-1] if instances is None else int(instances.first_triangle[0])
        shapes = [number for number, moves in enumerate(moving.shapes) if moves and firsts[number] < own]
        parts = [self.in_world(triangles, counts, tuple(shapes))]
        if instances is not None:
            parts += [self.in_group(triangles, counts, moving, instances, group, generator)
                      for group in range(len(instances.first_triangle) - 1)]
        return joined([part for part in parts if part is not None])

    def in_world(self, triangles: TriangleTable, counts: Sequence[int], shapes: tuple[int, ...]) -> Outline | None:
        """The edges of some shapes that are in the world."""
        mesh = self.mesh(triangles, counts, shapes)
        if mesh is None:
            return None
        instance = None if triangles.instances is None else torch.zeros_like(mesh.edges.vertex, dtype=torch.int32)
        jumps = mesh.creases.jumps(triangles.n)
        return Outline(mesh.edges, instance, jumps, torch.ones_like(jumps))

    def in_group(self, triangles: TriangleTable, counts: Sequence[int], moving: Moving, instances: Instances, group: int,
                 generator: torch.Generator) -> Outline | None:
        """The edges of a group, as its instances show them."""
        first, last = (int(instances.first_triangle[group + side]) for side in (0, 1))
        members = tuple(number for number, start in enumerate(accumulate(counts[:-1], initial=0)) if first <= start < last)
        everywhere = any(moving.shapes[member] for member in members)
        shows = slice(int(instances.first_instance[group]), int(instances.first_instance[group + 1]))
        mesh = self.mesh(triangles, counts, members) if everywhere or any(moving.instances[shows]) else None
        if mesh is None:
            return None
        edges, jumps = mesh.edges, mesh.creases.jumps(triangles.n)
        chosen, part = chosen_instances(instances, group, moving, everywhere, len(edges.a), generator)
        chosen = chosen.to(edges.a.device)
        times = torch.arange(len(chosen), device=chosen.device)

        def repeated(index: Tensor, step: int) -> Tensor:
            return (index + step * times[:, None]).flatten()

        shown = Edges(edges.vertex.repeat(len(chosen)), *(repeated(index, len(edges.vertex)) for index in edges[1:4]),
                      repeated(edges.edge, len(edges.a)), edges.corner.repeat(len(chosen)))
        jumps = jumps.repeat(len(chosen))
        return Outline(shown, (chosen + 1).to(torch.int32).repeat_interleave(len(edges.vertex)), jumps,
                       torch.full_like(jumps, part))

    def mesh(self, triangles: TriangleTable, counts: Sequence[int], shapes: tuple[int, ...]) -> OutlinedMesh | None:
        """The edges of some shapes, found anew only if triangles of the scene have changed; None: there are none."""
        known = self.known.get(shapes)
        tables, reads = (*triangles.corners, triangles.smooth), tuple(
            column is not None for column in (triangles.vertices.n, triangles.vertices.uv))
        if known is not None and known.reads == reads and all(map(unchanged, tables, (*known.corners, known.smooth))):
            return known
        shape = torch.repeat_interleave(torch.tensor(counts, device=triangles.material.device))
        chosen = torch.isin(shape, torch.tensor(shapes, device=shape.device)).nonzero().squeeze(1)
        if not len(chosen):
            return None
        edges = edges_of(triangles.vertices.p.stack(), torch.stack(triangles.corners, 1)[chosen])
        edges = edges._replace(corner=3 * chosen[torch.div(edges.corner, 3, rounding_mode="floor")] + edges.corner % 3)
        found = self.known[shapes] = OutlinedMesh(triangles.corners, triangles.smooth, reads, edges,
                                         creases(edges, triangles, shape))
        return found


def faces_of(scene: SceneTensors, counts: Sequence[int], moving: Moving, generator: torch.Generator) -> Faces | None:
    """The triangles of all that moves; None: there are none. Args as for `Outlines.of`."""
    triangles, firsts = scene.triangles, list(accumulate(counts, initial=0))
    device = triangles.material.device
    instances = None if triangles.instances is None else triangles.instances.casting
    own = firsts[-1] if instances is None else int(instances.first_triangle[0])

    def of_shapes(first: int, last: int, which: Sequence[bool]) -> Tensor:
        found = [torch.arange(start, start + count, device=device) for start, count, moves in zip(firsts, counts, which)
                 if moves and first <= start < last]
        return torch.cat(found) if found else torch.zeros(0, dtype=torch.int64, device=device)

    world = of_shapes(0, own, moving.shapes)
    share = torch.ones(len(world), dtype=torch.float64, device=device)
    parts = [Faces(world, None if instances is None else torch.zeros_like(world, dtype=torch.int32), share)]
    for group in range(0 if instances is None else len(instances.first_triangle) - 1):
        first, last = (int(instances.first_triangle[group + side]) for side in (0, 1))
        members = of_shapes(first, last, (True,) * len(counts))
        everywhere = len(of_shapes(first, last, moving.shapes)) > 0
        chosen, part = chosen_instances(instances, group, moving, everywhere, len(members), generator)
        shows = chosen.to(device, torch.int32) + 1
        parts.append(Faces(members.repeat(len(shows)), shows.repeat_interleave(len(members)),
                           torch.full((len(shows) * len(members),), part, dtype=torch.float64, device=device)))
    return joined_faces([part for part in parts if len(part.triangle)])


def chosen_instances(instances: Instances, group: int, moving: Moving, everywhere: bool, size: int,
                     generator: torch.Generator) -> tuple[Tensor, float]:
    """The instances of a group that are examined, int64 from 0, and which share they are of those that move.

    Args:
        instances: of all groups.
        group: which.
        moving: what does.
        everywhere: whether something in the group moves, and so all instances.
        size: of what each instance shows.
        generator: picks some where there are too many.
    """
    shows = range(int(instances.first_instance[group]), int(instances.first_instance[group + 1]))
    wanted = torch.tensor([number for number in shows if everywhere or moving.instances[number]], dtype=torch.int64)
    most = max(1, MOST_SHOWN // max(size, 1))
    if most >= len(wanted):
        return wanted, 1.0
    return wanted[torch.randperm(len(wanted), generator=generator)[:most]], most / len(wanted)


def unchanged(table: Tensor | None, known: Tensor | None) -> bool:
    """True if a table, or its absence, is what it was; tables are never written into."""
    return table is known if table is None or known is None else same(table, known)


def joined(parts: Sequence[Outline]) -> Outline | None:
    """All edges of several outlines."""
    if len(parts) < 2:
        return parts[0] if parts else None
    vertices, edges = 0, 0
    moved = []
    for part in parts:
        own = part.edges
        moved.append(Edges(own.vertex, own.a + vertices, own.b + vertices, own.opposite + vertices, own.edge + edges,
                           own.corner))
        vertices, edges = vertices + len(own.vertex), edges + len(own.a)
    columns = zip(*(part[1:] for part in parts))
    return Outline(Edges(*map(torch.cat, zip(*moved))), *map(torch.cat, columns))


def creases(edges: Edges, triangles: TriangleTable, shape: Tensor) -> Creases:
    """Where edges are creases.

    Args:
        edges: of triangles of this table.
        triangles: of the scene, detached.
        shape: (T,) that each triangle belongs to.
    """
    count = torch.bincount(edges.edge, minlength=len(edges.a))
    order = edges.edge.argsort(stable=True)
    pairs = (count == 2).nonzero().squeeze(1)
    first = (count.cumsum(0) - count)[pairs]
    one, two = order[first], order[first + 1]
    here, there = (torch.div(edges.corner[corner], 3, rounding_mode="floor") for corner in (one, two))
    corners = torch.stack(triangles.corners, 1)
    shared = (ends(corners, edges.corner[one]) == ends(corners, edges.corner[two])).all(1)
    smooth = torch.full_like(shared, triangles.vertices.n is not None)
    if triangles.smooth is not None:
        smooth &= triangles.smooth[here] & triangles.smooth[there]
    known = shape[here] == shape[there]
    known &= shared if triangles.vertices.uv is not None or triangles.vertices.attributes else shared | ~smooth
    known &= torch.full_like(shared, not triangles.attributes)
    fixed = torch.ones(len(count), device=count.device).index_put((pairs[known],), torch.zeros((), device=count.device))
    flat = known & ~smooth
    return Creases(fixed, pairs[flat], here[flat], there[flat])


def ends(corners: Tensor, corner: Tensor) -> Tensor:
    """The rows of the vertices at the ends of edges, in the triangle of a corner opposite to each; (P, 2) ascending.

    Args:
        corners: (T, 3) rows of vertices.
        corner: (P,) number of the corner among all.
    """
    triangle = corners[torch.div(corner, 3, rounding_mode="floor")]
    around = torch.stack([(corner + 1) % 3, (corner + 2) % 3], 1)
    return triangle.gather(1, around).sort(1).values
