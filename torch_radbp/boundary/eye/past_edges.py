"""What path vertices see right past edges, on straight ways and through media.

Rays that pass invisible boundaries of media are followed from the vertex on, past the edge, by one flight: it may end in a
medium before the edge or behind it, since all that a direction brings counts on the side that is not in shadow. There
points of flights keep their share of the way to the surface to which the direction is fixed.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.curve.outline import Outline
from torch_radbp.boundary.eye.seen_edges import BEFORE, Passed, unhidden
from torch_radbp.boundary.eye.viewpoints import Viewpoints, path_of
from torch_radbp.call.render_call import RenderCall
from torch_radbp.path.event import Ends
from torch_radbp.path.flight import point_along
from torch_radbp.path.integrand import Integrand
from torch_radbp.path.lanes import put_rows
from torch_radbp.path.passage import medium_beyond
from torch_radbp.path.state import Flight
from torch_radbp.path.through_media import free_flights
from torch_radbp.raycast.protocol import Hit
from torch_radbp.scene.tables.scene_tensors import SceneTensors
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.record import mapped
from torch_radbp.tensors.stage import stage
from torch_radbp.tensors.vec import Ray, Vec3, dot, normalize, rows, where
from torch_radbp.vertex.interaction import is_boundary, surface_interaction


class PastEdges(NamedTuple):
    """Rays from N viewpoints past edges, and the surfaces that they hit."""

    ray: Ray  # from the viewpoints, in the scene's dtype
    hit: Hit  # as seen from there
    medium: Tensor | None = None  # int32, in which they begin; None: they pass no boundaries
    flight: Flight | None = None  # by which they come to `hit`; None: the first bounce says so

    def fixed_to(self, scene: SceneTensors) -> Hit:
        """The hits to which directions are fixed when surfaces move; triangle -1: none, or a boundary of media."""
        if scene.boundaries is None:
            return self.hit
        return self.hit._replace(prim=torch.where(is_boundary(scene, self.hit.prim), -1, self.hit.prim))


def straight_past_edges(scene: SceneTensors, at: Vec3, passed: Passed, beyond: Hit) -> PastEdges:
    """The straight rays from viewpoints past edges, with the surfaces behind.

    Args:
        scene: any part of it.
        at: (M,) world positions of the viewpoints.
        passed: (N,) samples on edges as the viewpoints see them.
        beyond: (N,) the hits of rays that begin right beside the samples.
    """
    start = rows(at, passed.eye)
    reach = passed.p - start
    distance = torch.sqrt(dot(reach, reach)).to(scene.dtype)
    return PastEdges(Ray(start.map(lambda c: c.to(scene.dtype)), passed.onwards.d), beyond._replace(t=beyond.t + distance))


def seen_past_edges(call: RenderCall, integrand: Integrand, outline: Outline, points: Viewpoints, at: Vec3,
                    passed: Passed, alone: Tensor) -> tuple[Passed, PastEdges]:
    """The samples on edges that nothing hides from viewpoints, and what the viewpoints see past them, (K,).

    Args:
        call: detached.
        integrand: for the view.
        outline: the edges.
        points: (M,) the viewpoints, at positions `at`.
        passed: (N,) samples on edges as the viewpoints see them.
        alone: (N,) bool: samples that count even if no surface is behind.
    """
    if not call.scene.layout.traces_segments:
        hit = call.integrand.caster.intersect(passed.onwards)
        passed, hit = rows((passed, hit), ((hit.prim >= 0) | alone).nonzero().squeeze(1))
        passed, hit = rows((passed, hit), unhidden(call.integrand, passed))
        return passed, straight_past_edges(call.scene, at, passed, hit)
    hides = integrand.part(Ends.SURROUNDINGS).call(hides_all, outline.triangle(passed.edge))
    passed = rows(passed, hides.nonzero().squeeze(1))
    past = flown_past_edges(call, integrand, points, passed)
    reach = passed.onwards.o - past.ray.o
    shown = (past.hit.prim < 0) | (past.hit.t > torch.sqrt(dot(reach, reach)) * (1.0 - BEFORE))
    return rows((passed, past), shown.nonzero().squeeze(1))


@stage("scene")
def hides_all(scene: SceneTensors, prim: Tensor) -> Tensor:
    """(N,) bool: opaque triangles, which are neither boundaries of media nor panes that rays pass straight.

    Args:
        scene: any part of it, detached.
        prim: (N,) int32.
    """
    passes = is_boundary(scene, prim)
    appearance = lookup(scene.materials.appearance, lookup(scene.triangles.material, prim))
    for number, _, _ in scene.layout.panes:
        passes = passes | (appearance == number)
    return ~passes


def flown_past_edges(call: RenderCall, integrand: Integrand, points: Viewpoints, passed: Passed) -> PastEdges:
    """The ways from viewpoints past edges through media and their boundaries, (N,); args as for `seen_past_edges`."""
    own, integrand = rows(points, passed.eye), integrand.standing()
    ray, medium = integrand.part(Ends.SURROUNDINGS).call(leaving_towards, own.ray, own.hit, own.flight, passed.onwards.o)
    room = None
    for depth in own.depth.unique().tolist():
        lanes = (own.depth == depth).nonzero().squeeze(1).int()
        state = path_of(call, *rows((ray, passed.key), lanes))._replace(medium=rows(medium, lanes))
        found = free_flights(integrand, state, integrand.caster.intersect(state.ray), depth + 1)
        if room is None:
            room = mapped(found, lambda leaf: None if leaf is None else leaf.new_empty(len(medium)))
        put_rows(room, lanes, found)
    hit, flight = room or (rows(own.hit, own.depth), own.flight)
    return PastEdges(ray, hit, medium, flight)


@stage("scene")
def leaving_towards(scene: SceneTensors, ray: Ray, hit: Hit, flight: Flight, p: Vec3) -> tuple[Ray, Tensor | None]:
    """Rays from path vertices to world points p, and the numbers of the media in which they begin, (N,) each; None: rays are
    not followed through media.

    Args:
        scene: any part of it, detached.
        ray, hit, flight: of the path segments that arrive at the vertices.
    """
    si, ends = surface_interaction(scene, ray, hit), flight.t < torch.inf
    inside = point_along(ray, torch.where(ends, flight.t, 0.0))
    d = p - where(ends, inside, si.p)
    o = where(ends, inside, si.offset(d))
    leaving = Ray(o, normalize(p - o))
    if flight.medium is None:
        return leaving, None
    beyond = medium_beyond(scene, si.prim, dot(si.n, d), flight.medium)
    return leaving, torch.where(ends, flight.medium, beyond)
