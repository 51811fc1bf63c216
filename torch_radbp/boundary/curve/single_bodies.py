"""Self-intersections of single bodies: each mesh once, however many instances show it.

Where triangles of a mesh meet does not depend on the pose of what shows them: what one instance of a group has, all have. So
as long as vertices stay where they are, in the frame of their group, the curves are found once and looked for no more.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.curve.edges import Edges, joined_edges
from torch_radbp.boundary.curve.geometry import geometry_of
from torch_radbp.boundary.curve.moving import Moving, chosen_instances
from torch_radbp.boundary.curve.pierced import BodyEdges, edges_looked_at, probes, self_intersections, shape_of
from torch_radbp.boundary.curve.segments import Segments
from torch_radbp.boundary.curve.segments import joined_segments as joined_segments
from torch_radbp.call.render_call import RenderCall
from torch_radbp.raycast.caster_cache import same_values
from torch_radbp.scene.tables.scene_tensors import SceneTensors
from torch_radbp.tensors.differentiated import any_differentiated
from torch_radbp.tensors.vec import rows

MOST_STILL = 1 << 17  # edges of what stays as it is, up to which all are looked at, once


class MeshOfBodies(NamedTuple):
    """The edges of some shapes outside of groups, or of all shapes of a group."""

    edges: Edges
    group: int  # its index; -1: of the world


class FoundOnce(NamedTuple):
    """The self-intersections of bodies, cached together with what they depend on."""

    vertices: tuple[Tensor, ...]  # vertex positions, those of groups in their own frames
    seed: int | None  # seed by which edges were selected; None: all were examined
    segments: Segments | None  # of groups at their first instances


class Looked(NamedTuple):
    """The bodies that are tested for self-intersection, with the last result, if any."""

    meshes: tuple[MeshOfBodies, ...]
    may: list[bool]  # for each shape, whether it may belong to a self-intersecting body
    bodies: BodyEdges
    found: FoundOnce | None  # None: not examined yet

    def is_of(self, meshes: Sequence[MeshOfBodies], may: list[bool]) -> bool:
        """True if exactly these meshes were tested; compared by identity."""
        return may == self.may and len(meshes) == len(self.meshes) and all(
            one.edges.a is other.edges.a and one.group == other.group for one, other in zip(meshes, self.meshes))


def bodies_once(scene: SceneTensors, counts: Sequence[int], meshes: Sequence[MeshOfBodies], may: list[bool]) -> BodyEdges:
    """The edges of all bodies that may intersect themselves, each group once, at its first instance.

    Args:
        scene: detached.
        counts: the number of triangles of each shape, those of groups last.
        meshes: the edges of what moves.
        may: for each shape, whether it may belong to such a body.
    """
    instances, parts, shown_by = scene.triangles.casting_instances, [], []
    crosses, ends = torch.tensor(may, device=scene.device), shape_ends(scene, counts)
    for edges, group in meshes:
        own = crosses[shape_of(ends, torch.div(edges.corner[0], 3, rounding_mode="floor"))]
        parts.append(edges if own.all() else rows(edges, own.nonzero().squeeze(1)))
        first = 0 if group < 0 else first_shown(scene, group)
        shown_by.append(torch.full_like(parts[-1].count, first))
    return BodyEdges(joined_edges(parts), None if instances is None else torch.cat(shown_by))


def shape_ends(scene: SceneTensors, counts: Sequence[int]) -> Tensor:
    """(S,) int64, for each shape the end of its triangles among all."""
    return torch.tensor(list(accumulate(counts)), device=scene.device)


def first_shown(scene: SceneTensors, group: int) -> int:
    """The number of a group's first instance, as in a hit."""
    return scene.triangles.casting_instances.first_instance[group] + 1


def self_crossings(call: RenderCall, scene: SceneTensors, counts: Sequence[int], known: Looked, seed: int) -> FoundOnce:
    """Finds self-intersections of bodies, cached while vertices and seed are unchanged.

    Args:
        call: the rendering, in which something moves.
        scene: of the call, detached.
        counts: as for `bodies_once`.
        known: the bodies, and the last result.
        seed: of the choice of edges, if there are too many.
    """
    count, vertices = len(known.bodies.edges.a), tuple(scene.triangles.vertices.p)
    most = edges_looked_at(call) if any_differentiated(call.scene.triangles.vertices.p) else MOST_STILL
    chosen_by, last = None if count <= most else seed, known.found
    if last is not None and last.seed == chosen_by and all(map(same_values, last.vertices, vertices)):
        return last
    looked_at = probes(count, most, torch.Generator("cpu").manual_seed(seed % (1 << 63)))
    found = self_intersections(call.caster, call.stages, geometry_of(scene), known.bodies, looked_at,
                               shape_ends(scene, counts))
    return FoundOnce(vertices, chosen_by, found)


def shown_by_all(segments: Segments | None, scene: SceneTensors, counts: Sequence[int], moving: Moving,
                 seed: int) -> Segments | None:
    """Copies of segments, given at the first instance of each group, at all moving instances.

    Args:
        segments: at first instances; None: there are none.
        scene, counts: as for `bodies_once`.
        moving: the shapes and instances that move.
        seed: of the choice of instances, if there are too many.
    """
    instances = scene.triangles.casting_instances
    if segments is None or instances is None:
        return segments
    generator, starts = torch.Generator("cpu").manual_seed(seed % (1 << 63)), list(accumulate(counts, initial=0))
    parts = [rows(segments, (segments.instance == 0).nonzero().squeeze(1))]
    for group in range(len(instances.first_triangle) - 1):
        own = (segments.instance == first_shown(scene, group)).nonzero().squeeze(1)
        if not len(own):
            continue
        first, last = instances.first_triangle[group:group + 2]
        everywhere = any(moves for moves, start in zip(moving.shapes, starts) if first <= start < last)
        chosen, part = chosen_instances(instances, group, moving, everywhere, len(own), generator)
        shows = (chosen.to(own.device, torch.int32) + 1).repeat_interleave(len(own))
        every = rows(segments, own.repeat(len(chosen)))._replace(instance=shows, shown_by=shows)
        if part < 1.0:
            share = torch.ones_like(every.start.x) if every.share is None else every.share
            every = every._replace(share=share * part)
        parts.append(every)
    return joined_segments(parts)
