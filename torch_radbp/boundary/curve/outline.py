"""The edges of meshes in the world at which an image may be discontinuous: silhouettes and creases.

An image jumps at a silhouette, where a surface ends or turns away and another appears behind it, and at a crease, where two
surfaces meet that are shaded differently. Along all other edges, those inside of smoothly shaded surfaces and of planes, it
is continuous unless they are silhouettes.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence
from itertools import accumulate
from typing import NamedTuple
from weakref import WeakKeyDictionary

import torch
from torch import Tensor

from torch_radbp.boundary.curve.contacts import EdgeParts, Resting, edges_in_parts
from torch_radbp.boundary.curve.creases import FOLD, creases
from torch_radbp.boundary.curve.edge_order import EdgeSlots, slots_of
from torch_radbp.boundary.curve.edges import Edges, edges_of
from torch_radbp.boundary.curve.edges import joined_edges as joined_edges
from torch_radbp.boundary.curve.faces import Faces, with_shares
from torch_radbp.boundary.curve.geometry import geometry_of, in_world
from torch_radbp.boundary.curve.moving import Moving, chosen_instances, moving_faces
from torch_radbp.boundary.curve.passing import Passing, key_of, remember
from torch_radbp.boundary.curve.rendering import Rendering
from torch_radbp.boundary.curve.segments import Segments
from torch_radbp.boundary.curve.segments import joined_segments as joined_segments
from torch_radbp.boundary.curve.single_bodies import MeshOfBodies
from torch_radbp.boundary.curve.term import LineNumbers, line_numbers, lines_move, lines_on_shapes, names_sliding
from torch_radbp.boundary.curve.texture_lines import distinct, texture_segments
from torch_radbp.call.render_call import RenderCall
from torch_radbp.interface.instances import Instances
from torch_radbp.plugin.jump_lines import JumpLines
from torch_radbp.raycast.caster_cache import same_values
from torch_radbp.scene.modules.scene import Scene
from torch_radbp.scene.tables.scene_tensors import SceneTensors, TriangleTable
from torch_radbp.tensors.differentiated import any_differentiated
from torch_radbp.tensors.interleaved import interleaved
from torch_radbp.tensors.record import joined as joined_records
from torch_radbp.tensors.record import mapped
from torch_radbp.tensors.vec import rows


class Outline(NamedTuple):
    """E edges of a scene's triangles in the world, at which an image may be discontinuous, as stages read them."""

    edges: Edges  # by rows of the vertex table
    instance: Tensor | None  # (E,) int32 instance as in a hit; None: the scene has none
    crease: Tensor  # (E,) int32, discontinuity of an edge that is no silhouette: `NONE`, `WHOLE`, `FOLD`, ...
    folds: bool  # some are `FOLD` or `TURNED`
    share: Tensor | None  # (E,) float64, probability of the edge's selection; None: all are selected
    parts: EdgeParts | None = None  # (E,) the part of each edge; None: whole edges, which lie on no other surface
    slots: EdgeSlots | None = None  # of everything, see `edge_order.slots_of`

    def triangle(self, edge: Tensor) -> Tensor:
        """The first triangle at each of given edges, (N,) int32."""
        return torch.div(rows(self.edges.corner[0], edge), 3, rounding_mode="floor")


class Jumps(NamedTuple):
    """The edges, triangles and segments at which the image of a view may be discontinuous."""

    outline: Outline | None  # edges; None: there are none
    faces: Faces | None  # triangles that may contain curves
    segments: Segments | None  # straight curves inside of triangles
    lines: LineNumbers | None = None  # of the lines on surfaces among these, attached, where they move over these


class OutlinedMesh(NamedTuple):
    """The edges of some triangles, cached together with the tensors that they depend on."""

    corners: tuple[Tensor, Tensor, Tensor]  # of all triangles of the scene
    smooth: Tensor | None  # of all triangles of the scene
    reads: tuple[bool, ...]  # whether the scene has normals and surface coordinates of vertices
    outline: Outline  # without instances


class MeshShown(NamedTuple):
    """The edges of one mesh, and the instances that show it."""

    mesh: Outline | None  # without instances, never written into; None: there are none
    chosen: Tensor | None  # (C,) int64, instances from 0; None: it is in the world
    part: float  # fraction of the moving instances that were selected

    def equals(self, other: MeshShown) -> bool:
        """True if the other has the same edges and instances."""
        return self.mesh is other.mesh and self.part == other.part and _unchanged(self.chosen, other.chosen)

    def outline(self, instanced: bool) -> Outline:
        """The edges of the mesh as all chosen instances show them in the world; `instanced`: the scene has instances."""
        outline = self.mesh
        if self.chosen is None:
            return outline._replace(instance=torch.zeros_like(outline.crease)) if instanced else outline
        size, count = len(outline.crease), len(self.chosen)
        shows = (self.chosen.to(outline.crease.device, torch.int32) + 1).repeat_interleave(size)
        edges = mapped(outline.edges, lambda column: None if column is None else column.repeat(count))
        share = None if self.part == 1.0 else torch.full_like(shows, self.part, dtype=torch.float64)
        return Outline(edges, shows, outline.crease.repeat(count), outline.folds, share)


class Shown(NamedTuple):
    """The edges of all moving meshes, cached together with what they depend on."""

    meshes: list[MeshShown]
    outline: Outline | None


class Divided(NamedTuple):
    """Edges divided where they lie on other surfaces, cached together with what they depend on."""

    whole: Outline
    resting: Resting  # which depends on all places in the world
    outline: Outline


class Outlines:
    """Finds the edges of meshes, and caches them while triangles are unchanged."""

    def __init__(self) -> None:
        self.known: dict[object, OutlinedMesh] = {}
        self.shown: dict[Moving, Shown] = {}
        self.divided: dict[tuple[Moving, Moving], Divided] = {}  # by whose edges they are, and whose contacts
        self.faces: dict[Moving, tuple[tuple, Faces | None]] = {}  # with what they depend on
        self.order: tuple[tuple[Tensor, ...], EdgeSlots] | None = None
        self.sizes: tuple[int, int] | None = None  # triangles of everything, and its edges, when these were found last
        self.passing = Passing()

    def of_views(self, rendering: Rendering, seed: int) -> list[Jumps]:
        """The discontinuity curves of each view: those of moving shapes, or of all shapes if the camera moves. They are of
        all shapes, too, if paths begin at lamps and anything moves (`eye/lit_sides.py`).

        Args:
            rendering: the rendering, in which something moves.
            seed: of the choice of instances.
        """
        scene, generator = rendering.call.still_scene, torch.Generator("cpu").manual_seed(seed % (1 << 63))
        own = moving_in(rendering)
        turning, sliding = (own._replace(shapes=tuple(moves or bool(names) for moves, names in zip(own.shapes, more)))
                            for more in (rendering.turners, names_sliding(rendering)))
        everything = Moving(*((True,) * len(part) for part in own))
        follows_lamps = rendering.light_paths == "all" and any(map(any, own))
        wanted = [(everything,) * 3 if moving or follows_lamps else (own, turning, sliding)
                  for moving in rendering.camera_movers]
        sizes = rendering.sizes
        lines, edges_of_shape = lines_on_shapes(rendering), self.edges_of_shape(scene, sizes)
        numbers = numbers_of(lines, rendering.call)

        def jumps(moves: Moving, turns: Moving, slides: Moving) -> Jumps:
            resting = self.passing.of_pairs(rendering, moves, edges_of_shape, seed).resting
            outline = self.in_parts(scene, (moves, moves), self.of(scene, sizes, moves, generator), resting)
            faces = self.faces_of(scene, sizes, turns, generator)
            patterned = moving_faces(scene, sizes, slides, generator) if any(lines) else None
            segments = [] if patterned is None else [texture_segments(scene, patterned, sizes, lines)]
            segments += self.passing.segments(rendering, moves, self.of_bodies(scene, sizes, moves), edges_of_shape, seed)
            return Jumps(outline, faces, joined_segments([part for part in segments if part is not None]), numbers)

        found = {three: jumps(*three) for three in dict.fromkeys(wanted)}
        return [found[three] for three in wanted]

    def sliding(self, rendering: Rendering, seed: int) -> tuple[Segments | None, LineNumbers | None]:
        """The segments of texture lines that move over surfaces, and the lines' coefficients; args as for `of_views`."""
        names, lines = names_sliding(rendering), lines_on_shapes(rendering)
        numbers = numbers_of(lines, rendering.call) if any(names) else None
        if numbers is None:
            return None, None
        scene, generator = rendering.call.still_scene, torch.Generator("cpu").manual_seed(seed % (1 << 63))
        slides = Moving(tuple(map(bool, names)), (False,) * len(rendering.moving_instances))
        faces = moving_faces(scene, rendering.sizes, slides, generator)
        return None if faces is None else texture_segments(scene, faces, rendering.sizes, lines), numbers

    def faces_of(self, scene: SceneTensors, counts: Sequence[int], moving: Moving,
                 generator: torch.Generator) -> Faces | None:
        """The triangles of all shapes that move, cached; args as for `of`."""
        key, known = key_of(scene, counts), self.faces.get(moving)
        if known is not None and known[0] == key:
            return known[1]
        faces = moving_faces(scene, counts, moving, generator)
        if faces is None or faces.share is None:  # otherwise of some instances: others in the next call
            remember(self.faces, moving, (key, faces))
        return faces

    def edges_expected(self, triangles: int) -> int:
        """The expected number of edges of `triangles` triangles: that of last time, or the greatest possible."""
        return self.sizes[1] if self.sizes is not None and self.sizes[0] == triangles else 3 * triangles

    def of_everything(self, rendering: Rendering, seed: int, most: int | None = None) -> Outline | None:
        """The edges of all shapes of a scene; None: there are none. Args as for `of_views`.

        `most`: return at most so many, not divided where they lie on other surfaces; None: all.
        """
        everything = Moving(*((True,) * len(part) for part in (rendering.movers, rendering.moving_instances)))
        generator, sizes = torch.Generator("cpu").manual_seed(seed % (1 << 63)), rendering.sizes
        scene = rendering.call.still_scene
        found = self.of(scene, sizes, everything, generator)
        if found is None:
            return None
        if most is not None:
            some = torch.arange(0, len(found.crease), -(-len(found.crease) // most), device=found.crease.device)
            found = rows(found._replace(folds=None), some)._replace(folds=found.folds)
        elif (passing := moving_or_sliding(rendering)) is not None:
            pairs = self.passing.of_pairs(rendering, passing, self.edges_of_shape(scene, sizes), seed)
            found = self.in_parts(scene, (everything, passing), found, pairs.resting)
        self.sizes = (len(scene.triangles.material), len(found.crease)) if most is None else self.sizes
        shape = torch.repeat_interleave(torch.tensor(sizes, device=found.crease.device)).int()
        body = rows(shape, torch.div(found.edges.corner[0], 3, rounding_mode="floor"))
        body = body if found.instance is None else body + found.instance * len(sizes)
        return found._replace(slots=self.order_of(scene, found, body))

    def in_parts(self, scene: SceneTensors, moving: tuple[Moving, Moving], outline: Outline | None,
                 resting: Resting | None) -> Outline | None:
        """Divides the edges of an outline where they lie on other surfaces, cached.

        Args:
            scene: detached.
            moving: the shapes and instances whose edges these are, and those whose contacts are known.
            outline: edges; None: there are none.
            resting: the parts of edges that lie on other surfaces; None: there are none.
        """
        if outline is None or resting is None:
            return outline
        known = self.divided.get(moving)
        if known is None or known.whole is not outline or known.resting is not resting:
            found, parts = edges_in_parts(geometry_of(scene), outline.edges, outline.instance, resting) or (None, None)
            known = Divided(outline, resting, outline if found is None else rows(
                outline._replace(folds=None), found)._replace(folds=outline.folds, parts=parts))
            remember(self.divided, moving, known)
        return known.outline

    def order_of(self, scene: SceneTensors, outline: Outline, body: Tensor) -> EdgeSlots:
        """The edges in the order of a tree over them, cached; `body`: (E,) the body of each edge."""
        edges, instance = outline.edges, outline.instance
        tables = (edges.a, edges.b, body, *edges.opposite)
        if self.order is None or len(tables) != len(self.order[0]) or not all(map(_unchanged, tables, self.order[0])):
            points, = in_world(geometry_of(scene), (edges.a,), instance)
            slots = slots_of(body, points.stack())
            found = EdgeSlots(slots, *rows(((edges.a, edges.b, *edges.opposite), instance), slots.clamp_min(0)))
            self.order = tables, interleaved(found)
        return self.order[1]

    def of(self, scene: SceneTensors, counts: Sequence[int], moving: Moving, generator: torch.Generator) -> Outline | None:
        """The edges of all shapes that move; None: nothing moves.

        Args:
            scene: detached.
            counts: the number of triangles of each shape, those of groups last.
            moving: the shapes and instances that move.
            generator: selects instances if there are too many; on the CPU.
        """
        triangles = scene.triangles
        instances = triangles.casting_instances
        meshes = [MeshShown(self.mesh(triangles, counts, in_the_world(scene, counts, moving)), None, 1.0)]
        if instances is not None:
            meshes += [self.in_group(triangles, counts, moving, instances, group, generator)
                       for group in range(len(instances.first_triangle) - 1)]
        meshes = [shown for shown in meshes if shown.mesh is not None]
        known = self.shown.get(moving)
        if known is None or len(known.meshes) != len(meshes) or not all(map(MeshShown.equals, meshes, known.meshes)):
            known = Shown(meshes, joined_outlines([shown.outline(triangles.instances is not None) for shown in meshes]))
        if all(shown.part == 1.0 for shown in meshes):  # otherwise some instances: others in the next call
            remember(self.shown, moving, known)
        return known.outline

    def crossing(self, rendering: Rendering, seed: int) -> Segments | None:
        """The segments along which bodies intersect, if one moves or its points may slide; None: there are none.

        Self-intersections are included. Args as for `of_views`.
        """
        wanted, scene, sizes = moving_or_sliding(rendering), rendering.call.still_scene, rendering.sizes
        if wanted is None:
            return None
        meshes, edges_of_shape = self.of_bodies(scene, sizes, wanted), self.edges_of_shape(scene, sizes)
        return joined_segments(self.passing.segments(rendering, wanted, meshes, edges_of_shape, seed))

    def edges_of_shape(self, scene: SceneTensors, counts: Sequence[int]) -> Callable[[int], Edges]:
        """A function that returns the edges of a shape by its number; args as for `of`."""
        return lambda number: self.mesh(scene.triangles, counts, (number,)).edges

    def of_bodies(self, scene: SceneTensors, counts: Sequence[int], moving: Moving) -> list[MeshOfBodies]:
        """The edges of all meshes that move, once for all instances; args as for `of`."""
        triangles, instances = scene.triangles, scene.triangles.casting_instances
        parts = [(self.mesh(triangles, counts, in_the_world(scene, counts, moving)), -1)]
        if instances is not None:
            for group in range(len(instances.first_triangle) - 1):
                members, everywhere, moves = of_group(instances, counts, moving, group)
                if everywhere or moves:
                    parts.append((self.mesh(triangles, counts, members), group))
        return [MeshOfBodies(outline.edges, group) for outline, group in parts if outline is not None]

    def of_meshes(self, rendering: Rendering) -> list[Outline]:
        """The edges of all shapes: those outside of groups, then those of each group in its own frame."""
        triangles, counts = rendering.call.still_scene.triangles, rendering.sizes
        instances, firsts = triangles.casting_instances, list(accumulate(rendering.sizes, initial=0))
        starts = [firsts[-1]] if instances is None else list(instances.first_triangle)
        parts = [tuple(number for number, start in enumerate(firsts[:-1]) if first <= start < last)
                 for first, last in zip([0, *starts], [*starts, firsts[-1]])]
        return [outline for part in parts if (outline := self.mesh(triangles, counts, part)) is not None]

    def in_group(self, triangles: TriangleTable, counts: Sequence[int], moving: Moving, instances: Instances, group: int,
                 generator: torch.Generator) -> MeshShown:
        """The edges of a group's meshes, and the instances that show them."""
        members, everywhere, moves = of_group(instances, counts, moving, group)
        mesh = self.mesh(triangles, counts, members) if everywhere or moves else None
        if mesh is None:
            return MeshShown(None, None, 1.0)
        return MeshShown(mesh, *chosen_instances(instances, group, moving, everywhere, len(mesh.crease), generator))

    def mesh(self, triangles: TriangleTable, counts: Sequence[int], shapes: tuple[int, ...]) -> Outline | None:
        """The edges of some shapes, cached while their triangles are unchanged; None: there are none."""
        known = self.known.get(shapes)
        tables, reads = (*triangles.corners, triangles.smooth), tuple(
            column is not None for column in (triangles.vertices.n, triangles.vertices.uv))
        if known is not None and known.reads == reads and all(map(_unchanged, tables, (*known.corners, known.smooth))):
            return known.outline
        device, firsts = triangles.material.device, list(accumulate(counts, initial=0))
        own = [torch.arange(firsts[number], firsts[number + 1], dtype=torch.int32, device=device) for number in shapes
               if counts[number]]
        if not own:
            return None
        chosen = torch.cat(own)
        faces = torch.stack([rows(corner, chosen) for corner in triangles.corners], 1)
        edges = edges_of(triangles.vertices.p.stack(), faces)
        if not len(edges.a):
            return None
        if int(chosen[-1]) >= len(chosen):
            edges = edges._replace(corner=tuple(
                3 * rows(chosen, torch.div(corner, 3, rounding_mode="floor")) + corner % 3 for corner in edges.corner))
        shape = None if len(own) == 1 else torch.repeat_interleave(torch.tensor(counts, device=device)).int()
        crease = creases(edges, triangles, shape)
        outline = Outline(edges._replace(alike=None, seam=None), None, crease, bool((crease >= FOLD).any()), None)
        self.known[shapes] = OutlinedMesh(triangles.corners, triangles.smooth, reads, outline)
        return outline


KNOWN: WeakKeyDictionary[Scene, Outlines] = WeakKeyDictionary()


def numbers_of(lines: Sequence[tuple[JumpLines, ...]], call: RenderCall) -> LineNumbers | None:
    """The coefficients of the texture lines on all shapes, attached; None: no line moves over its surface."""
    every = distinct(lines)
    numbers = line_numbers(every, call.scene.device) if every else None
    return numbers if every and (lines_move(numbers) or any_differentiated(call.scene.triangles.vertices.uv)) else None


def in_the_world(scene: SceneTensors, counts: Sequence[int], moving: Moving) -> tuple[int, ...]:
    """The indices of the moving shapes that stand outside of groups; args as for `Outlines.of`."""
    instances = scene.triangles.casting_instances
    last = sum(counts) if instances is None else instances.first_triangle[0]
    starts = accumulate(counts[:-1], initial=0)
    return tuple(number for number, (moves, start) in enumerate(zip(moving.shapes, starts)) if moves and start < last)


def of_group(instances: Instances, counts: Sequence[int], moving: Moving, group: int) -> tuple[tuple[int, ...], bool, bool]:
    """The indices of a group's shapes, whether one of these shapes moves, and whether an instance of the group moves."""
    first, last = instances.first_triangle[group:group + 2]
    members = tuple(number for number, start in enumerate(accumulate(counts[:-1], initial=0)) if first <= start < last)
    shows = slice(*instances.first_instance[group:group + 2])
    return members, any(moving.shapes[member] for member in members), any(moving.instances[shows])


def moving_in(rendering: Rendering) -> Moving:
    """The shapes and instances that move by parameters of the scene; cameras do not count."""
    return Moving(tuple(map(bool, rendering.movers)), rendering.moving_instances)


def moving_or_sliding(rendering: Rendering) -> Moving | None:
    """The shapes and instances that move, or whose points may slide when something moves; None: nothing moves."""
    moving = moving_in(rendering)
    if not any(moving.shapes) and not any(moving.instances) and not any(rendering.camera_movers):
        return None
    return moving._replace(shapes=tuple(map(operator.or_, moving.shapes, rendering.plain)))


def outlines_of(scene: Scene) -> Outlines:
    """The object that finds and caches the edges of a scene's meshes, shared by all that render the scene."""
    return KNOWN.setdefault(scene, Outlines())


def _unchanged(table: Tensor | None, known: Tensor | None) -> bool:
    """True if a table has the values that it had, or is missing as it was."""
    return table is known if table is None or known is None else same_values(table, known)


def joined_outlines(parts: Sequence[Outline]) -> Outline | None:
    """Joins the edges of several outlines into one; None: there are none."""
    if len(parts) < 2:
        return parts[0] if parts else None
    parts = with_shares(parts)
    return Outline(joined_edges([part.edges for part in parts]),
                   joined_records([part.instance for part in parts]), torch.cat([part.crease for part in parts]),
                   any(part.folds for part in parts), joined_records([part.share for part in parts]))
