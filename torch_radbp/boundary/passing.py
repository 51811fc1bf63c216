"""Where bodies pass through each other, or through themselves, found anew only if something has moved."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.geometry import geometry_of
from torch_radbp.boundary.intersections import Bodies, intersections
from torch_radbp.boundary.moving import Moving, faces_of
from torch_radbp.boundary.pierced import BodyEdges, edges_looked_at, probes, self_intersections, shape_of
from torch_radbp.boundary.rendering import Rendering
from torch_radbp.boundary.segments import Segments
from torch_radbp.call.render_call import RenderCall
from torch_radbp.raycast.caster_cache import same
from torch_radbp.scene.tensors import SceneTensors
from torch_radbp.tensors.differentiated import detached
from torch_radbp.tensors.record import leaves_of
from torch_radbp.tensors.vec import rows

MOST_KNOWN = 4  # selections of what moves for which bodies are remembered


class Known(NamedTuple):
    """Where bodies pass through each other, and what that depends on."""

    key: tuple  # of the bodies
    bodies: Bodies | None  # None: there are less than two
    place: tuple[Tensor, ...]  # of vertices and instances; (): not yet known
    segments: Segments | None


class Passing:
    """Finds where bodies pass through each other and through themselves."""

    def __init__(self) -> None:
        self.known: dict[Moving, Known] = {}

    def segments(self, rendering: Rendering, call: RenderCall, moving: Moving, edges: BodyEdges | None,
                 generator: torch.Generator) -> list[Segments]:
        """The segments of all that moves, each in parts that may be none.

        Args:
            rendering: the call's.
            call: of which something moves.
            moving: what does.
            edges: of that; None: there are none.
            generator: picks instances and edges where there are too many; on the CPU.
        """
        scene = detached(call.scene)
        found = (self.of_pairs(rendering, call, scene, moving, generator),
                 of_single(rendering, call, scene, moving, edges, generator))
        return [own for own in found if own is not None]

    def of_pairs(self, rendering: Rendering, call: RenderCall, scene: SceneTensors, moving: Moving,
                 generator: torch.Generator) -> Segments | None:
        """Those of two bodies each; args as for `segments`, and the scene of the call, detached."""
        instances, casting = scene.triangles.instances, scene.triangles.casting_instances
        key = scene.device, tuple(rendering.sizes), None if casting is None else (
            *casting.first_triangle.tolist(), *casting.first_instance.tolist())
        known = self.known.get(moving)
        if known is None or known.key != key:
            known = Known(key, bodies_of(scene, rendering.sizes, moving, generator), (), None)
        if known.bodies is None:
            self.remember(moving, known)
            return None
        place = *scene.triangles.vertices.p, *(() if instances is None else leaves_of((instances.linear, instances.origin)))
        if not known.place or not all(map(same, known.place, place)):
            known = known._replace(place=place, segments=intersections(call.stages, geometry_of(scene), known.bodies))
        if known.bodies.faces.share is None:  # otherwise some instances: others in the next call
            self.remember(moving, known)
        return known.segments

    def remember(self, moving: Moving, known: Known) -> None:
        """Keeps what is known of a selection of what moves, and forgets the oldest of many."""
        self.known.pop(moving, None)
        self.known[moving] = known
        if len(self.known) > MOST_KNOWN:
            self.known.pop(next(iter(self.known)))


def of_single(rendering: Rendering, call: RenderCall, scene: SceneTensors, moving: Moving, edges: BodyEdges | None,
              generator: torch.Generator) -> Segments | None:
    """The segments of single bodies that pass through themselves; args as for `Passing.segments`, and the scene of the call,
    detached."""
    there = with_groups(rendering, moving)
    may = [crosses and own for crosses, own in zip(rendering.self_crossing, there)]
    if edges is None or not any(may):
        return None
    count, wanted = len(edges.edges.a), None
    ends = torch.tensor(rendering.sizes, device=scene.device).cumsum(0)
    if may != there:
        own = shape_of(ends, torch.div(edges.edges.corner[0], 3, rounding_mode="floor"))
        wanted = torch.tensor(may, device=scene.device)[own].nonzero().squeeze(1)
        count = len(wanted)
    looked_at = probes(count, edges_looked_at(call), generator)
    if wanted is not None:
        looked_at = looked_at._replace(edge=wanted[looked_at.edge.to(scene.device)])
    return self_intersections(call.caster, geometry_of(scene), edges, looked_at, ends)


def with_groups(rendering: Rendering, moving: Moving) -> list[bool]:
    """For each shape, whether it moves, or something in its group does."""
    groups = [None if instances is None else id(instances[0].shapegroup) for instances in rendering.scene.shown_by]
    moved = {group for group, moves in zip(groups, moving.shapes) if moves and group is not None}
    return [moves or group in moved for group, moves in zip(groups, moving.shapes)]


def bodies_of(scene: SceneTensors, counts: Sequence[int], moving: Moving, generator: torch.Generator) -> Bodies | None:
    """All bodies, and which of them move; None: there are less than two. Args as for `Outlines.of`."""
    faces = faces_of(scene, counts, Moving(*((True,) * len(part) for part in moving)), generator)
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
