"""Intersections of bodies with each other or with themselves, cached while nothing moves."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.curve.contacts import Resting, contacts_of
from torch_radbp.boundary.curve.edges import Edges
from torch_radbp.boundary.curve.geometry import geometry_of
from torch_radbp.boundary.curve.intersections import Bodies, intersections
from torch_radbp.boundary.curve.moving import Moving, moving_faces
from torch_radbp.boundary.curve.rendering import Rendering
from torch_radbp.boundary.curve.segments import Segments, joined_segments
from torch_radbp.boundary.curve.single_bodies import (
    FoundOnce,
    Looked,
    MeshOfBodies,
    bodies_once,
    self_crossings,
    shape_ends,
    shown_by_all,
)
from torch_radbp.raycast.caster_cache import same_values
from torch_radbp.scene.tables.scene_tensors import SceneTensors
from torch_radbp.tensors.record import leaves_of
from torch_radbp.tensors.vec import rows

MOST_KNOWN = 4  # selections of what moves for which bodies are remembered


class CachedIntersections(NamedTuple):
    """The intersections of bodies, cached together with what they depend on."""

    key: tuple  # of the bodies
    bodies: Bodies | None  # None: fewer than two
    place: tuple[Tensor, ...]  # of vertices and instances; (): not computed yet
    segments: Segments | None  # contacts included
    resting: Resting | None = None  # edges that lie on other surfaces


class ShownByAll(NamedTuple):
    """The self-intersections of bodies at all instances, cached together with what they depend on."""

    key: tuple  # of the bodies
    found: FoundOnce  # at the first instance of each body
    segments: Segments | None


class Passing:
    """Finds, and caches, the intersections of bodies with each other and with themselves."""

    def __init__(self) -> None:
        self.known: dict[Moving, CachedIntersections] = {}
        self.looked: dict[Moving, Looked] = {}  # at single bodies
        self.shown: dict[Moving, ShownByAll] = {}

    def segments(self, rendering: Rendering, moving: Moving, meshes: Sequence[MeshOfBodies],
                 edges_of_shape: Callable[[int], Edges], seed: int) -> list[Segments]:
        """The segments along which moving bodies intersect others or themselves, in several sets.

        Args:
            rendering: the rendering, in which something moves.
            moving: the shapes and instances that move.
            meshes: the edges of these.
            edges_of_shape: the edges of one shape, by its number.
            seed: of the choice of instances and edges where there are too many.
        """
        found = (self.of_pairs(rendering, moving, edges_of_shape, seed).segments,
                 self.of_single(rendering, moving, meshes, seed))
        return [own for own in found if own is not None]

    def of_single(self, rendering: Rendering, moving: Moving, meshes: Sequence[MeshOfBodies], seed: int) -> Segments | None:
        """The segments along which moving bodies intersect themselves; args as for `segments`."""
        scene = rendering.call.still_scene
        may = [crosses and own for crosses, own in zip(rendering.self_crossing, with_groups(rendering, moving))]
        if not meshes or not any(may):
            return None
        known = self.looked.get(moving)
        if known is None or not known.is_of(meshes, may):
            known = Looked(tuple(meshes), may, bodies_once(scene, rendering.sizes, meshes, may), None)
        known = known._replace(found=self_crossings(rendering.call, scene, rendering.sizes, known, seed))
        remember(self.looked, moving, known)
        key, last = key_of(scene, rendering.sizes), self.shown.get(moving)
        if last is not None and last.found is known.found and last.key == key:
            return last.segments
        segments = shown_by_all(known.found.segments, scene, rendering.sizes, moving, seed)
        if segments is None or segments.share is None:  # otherwise of some instances: others in the next call
            remember(self.shown, moving, ShownByAll(key, known.found, segments))
        return segments

    def of_pairs(self, rendering: Rendering, moving: Moving, edges_of_shape: Callable[[int], Edges],
                 seed: int) -> CachedIntersections:
        """The intersections and contacts of pairs of bodies of which one moves; args as for `segments`."""
        scene, generator = rendering.call.still_scene, torch.Generator("cpu").manual_seed(seed % (1 << 63))
        instances, key = scene.triangles.instances, key_of(scene, rendering.sizes)
        known = self.known.get(moving)
        if known is None or known.key != key:
            known = CachedIntersections(key, bodies_of(scene, rendering.sizes, moving, generator), (), None)
        if known.bodies is None:
            remember(self.known, moving, known)
            return known
        place = *scene.triangles.vertices.p, *(() if instances is None else leaves_of((instances.linear, instances.origin)))
        if not known.place or not all(map(same_values, known.place, place)):
            geometry = geometry_of(scene)
            segments, touching = intersections(rendering.call.stages, geometry, known.bodies)
            contacts = None if touching is None else contacts_of(
                geometry, touching, shape_ends(scene, rendering.sizes), edges_of_shape)
            parts = [part for part in (segments, contacts and contacts.segments) if part is not None]
            known = known._replace(place=place, segments=joined_segments(parts), resting=contacts and contacts.resting)
        if known.bodies.faces.share is None:  # otherwise some instances: others in the next call
            remember(self.known, moving, known)
        return known


def key_of(scene: SceneTensors, counts: Sequence[int]) -> tuple:
    """A cache key that is equal for scenes with the same numbers of triangles and instances."""
    casting = scene.triangles.casting_instances
    return scene.device, tuple(counts), None if casting is None else (
        *casting.first_triangle, *casting.first_instance)


def remember(known: dict[Any, Any], key: Any, found: Any) -> None:
    """Caches a result, such as of a selection of moving bodies, and drops the oldest entries."""
    known.pop(key, None)
    known[key] = found
    if len(known) > MOST_KNOWN:
        known.pop(next(iter(known)))


def with_groups(rendering: Rendering, moving: Moving) -> list[bool]:
    """For each shape, whether it moves, or another shape of its group does."""
    groups = [None if instances is None else id(instances[0].shapegroup) for instances in rendering.scene.shown_by]
    moved = {group for group, moves in zip(groups, moving.shapes) if moves and group is not None}
    return [moves or group in moved for group, moves in zip(groups, moving.shapes)]


def bodies_of(scene: SceneTensors, counts: Sequence[int], moving: Moving, generator: torch.Generator) -> Bodies | None:
    """The triangles of all bodies, and which bodies move; None: fewer than two. Args as for `Outlines.of`."""
    faces = moving_faces(scene, counts, Moving(*((True,) * len(part) for part in moving)), generator)
    if faces is None:
        return None
    device, shapes = faces.triangle.device, len(counts)
    body = rows(torch.repeat_interleave(torch.tensor(counts, device=device)), faces.triangle)
    moves = torch.tensor(moving.shapes, device=device)[body]
    if faces.instance is not None:
        shown = faces.instance > 0
        moves = moves | torch.tensor([False, *moving.instances], device=device)[faces.instance]
        body = torch.where(shown, shapes + faces.instance, body)
    _, sizes = torch.unique_consecutive(body, return_counts=True)
    moves = torch.segment_reduce(moves.float(), "max", lengths=sizes) > 0
    return Bodies(faces, sizes, moves) if len(sizes) > 1 else None
