"""Camera paths as far as they are scattered ideally: reflected by mirrors, refracted by glass, into single directions."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.reflections.surfaces import Surfaces, cells_met
from torch_radbp.boundary.shadows.light_points import light_line
from torch_radbp.boundary.shadows.seen_edges import BEFORE, FAR
from torch_radbp.jit.order import chosen
from torch_radbp.path.bounce import Vertex
from torch_radbp.path.direct_light import LightDraw
from torch_radbp.path.integrand import Integrand
from torch_radbp.path.queues import Queue
from torch_radbp.path.state import PathState
from torch_radbp.path.wavefront import Step, bounce_queues, first_hit, put_rows, queued
from torch_radbp.raycast.protocol import Hit
from torch_radbp.scene.interaction import shading_normal, surface_interaction, triangle_normal
from torch_radbp.scene.tensors import SceneTensors
from torch_radbp.tensors.record import joined
from torch_radbp.tensors.vec import Ray, Vec3, dot, max_component, rows

MOST_VERTICES = 16  # of a path that are looked at
NO_ROULETTE = 1 << 30
# What is known of a vertex, bits of a number: the path meets the side of the shading normal; it is scattered ideally, and
# goes on; to the other side of the shading normal; on the side of the triangle's own normal; it ends, on a surface that the
# light of a sample reaches.
FRONT, ONWARDS, THROUGH, OUTSIDE, LIT = (1 << bit for bit in range(5))


class Reached(NamedTuple):
    """What paths meet after as many ideal vertices each, (M,); detached."""

    ray: Ray
    hit: Hit
    what: Tensor  # (M,) int32, FRONT + ...
    cells: tuple[Tensor, ...]  # (M,) each, from `cells_met`


class Vertices(NamedTuple):
    """The vertices of N paths after as many ideal ones each."""

    place: Tensor  # (N,) int32, which of the M that come so far each path is; -1: it ends before
    met: Reached


class LightLooks(NamedTuple):
    """Light samples, N, from which shadows are looked for."""

    draw: LightDraw
    sharp: Tensor  # (N,) bool: of light without extent; others are left out


IdealPath = tuple[Vertices, ...]  # vertex by vertex, from what the camera sees on


def only_ideal(integrand: Integrand) -> Integrand:
    """The integrand by which ideal vertices are followed: light is not looked for, and no path is ended by chance."""
    return integrand._replace(settings=integrand.settings._replace(nee=False), rr_depth=NO_ROULETTE,
                              max_depth=min(integrand.max_depth, MOST_VERTICES))


def ideal_path(integrand: Integrand, start: PathState, surfaces: Surfaces) -> IdealPath:
    """Follows paths until they meet something that does not scatter ideally, or nothing; at most to their last vertex.

    Args:
        integrand: from `only_ideal`, of a detached scene.
        start: (N,) of the paths, lanes in order.
        surfaces: of the scene, prepared for the stages.
    """
    found, state, place = [], start, start.lane
    for depth in range(integrand.max_depth):
        if not len(state.lane):
            break
        hit = first_hit(integrand, state.ray, depth)
        onwards = Vec3.buffer(state.pdf)
        lanes, vertex = (state.lane[:0], None) if integrand.is_last(depth) else (
            ideally_scattered(integrand, state, hit, depth))
        if len(lanes):
            goes_on = chosen(torch.isinf(vertex.next.pdf) & vertex.survives & (max_component(vertex.next.beta) > 0))
            lanes, ahead = lanes[goes_on], integrand.stages.rows(vertex.next, goes_on)
            put_rows(onwards, lanes, ahead.ray.d)
        found.append(Vertices(place, integrand.stages.ideal_vertex(surfaces, state.ray, hit, onwards)))
        if not len(lanes):
            break
        state = ahead
        place = torch.full_like(start.lane, -1)
        place[state.lane.long()] = torch.arange(len(state.lane), dtype=torch.int32, device=place.device)
    return tuple(found)


def ideal_vertex(surfaces: Surfaces, ray: Ray, hit: Hit, onwards: Vec3) -> Reached:
    """What is known of vertices that rays meet, (N,); `onwards`: the directions in which paths go on ideally; 0: in none."""
    n = triangle_normal(surfaces, hit)
    shading = shading_normal(surfaces, hit, n)
    cosine, met = dot(shading, ray.d), hit.prim >= 0
    goes_on = dot(onwards, onwards) > 0.0
    what = torch.zeros_like(hit.prim)
    for bit, holds in ((FRONT, (cosine < 0.0) | ~met), (ONWARDS, goes_on), (THROUGH, dot(shading, onwards) * cosine > 0.0),
                       (OUTSIDE, dot(n, onwards) > 0.0)):
        what = what + torch.where(holds, bit, 0).to(what.dtype)
    return Reached(ray, hit, what, cells_met(surfaces, hit))


def ideally_scattered(integrand: Integrand, state: PathState, hit: Hit, depth: int) -> tuple[Tensor, Vertex | None]:
    """The lanes that may be scattered ideally, (M,) int32, and their vertices; None if there are none."""
    front, order, queues = queued(integrand, state.ray, hit, last=False)
    ideal = [queue for queue in queues if queue.event.scatters and integrand.scatterer(queue.event).kind.delta]
    if not ideal:
        return order[:0], None
    order = torch.cat([order[queue.first:queue.last] for queue in ideal])
    packed, first = [], 0
    for queue in ideal:
        last = first + queue.last - queue.first
        packed.append(Queue(queue.event, first, last))
        first = last
    undecided = hit.prim.new_empty(0, dtype=torch.bool)
    step = Step(hit, front, order, tuple(packed), undecided, undecided, texture_values=(None,) * len(packed))
    vertex, _ = bounce_queues(integrand, state, depth, step, with_light=False)
    return order, vertex


def some_of(path: IdealPath, chosen: Tensor) -> IdealPath:
    """Some paths, (M,) int64 which, in this order; as many vertices as the longest of them has."""
    found = []
    for place, met in path:
        own = place[chosen]
        here = own >= 0
        left = own[here]
        if not len(left):
            break
        found.append(Vertices(torch.where(here, here.cumsum(0) - 1, -1).to(own.dtype), rows(met, left)))
    return tuple(found)


def extended(path: IdealPath, more: IdealPath) -> IdealPath:
    """Some paths and then others."""
    count, others = len(path[0].place), len(more[0].place)
    found = []
    for number in range(max(len(path), len(more))):
        parts = [own[number] for own in (path, more) if number < len(own)]
        first = len(parts[0].met.what)
        places = [path[number].place if number < len(path) else parts[0].place.new_full((count,), -1),
                  more[number].place if number < len(more) else parts[0].place.new_full((others,), -1)]
        if len(parts) == 2:
            places[1] = torch.where(places[1] < 0, -1, places[1] + first)
        found.append(Vertices(torch.cat(places), joined([part.met for part in parts])))
    return tuple(found)


def begins(path: IdealPath) -> Tensor:
    """(N,) bool: the camera sees an ideal surface."""
    return (path[0].met.what & ONWARDS) > 0


def along(path: IdealPath, chosen: Tensor, depth: Tensor) -> Reached:
    """What some of the paths, (K,), meet after so many vertices each, (K,) int64, which they do."""
    parts, order = [], []
    for number, (place, met) in enumerate(path):
        own = (depth == number).nonzero().squeeze(1)
        order.append(own)
        parts.append(rows(met, place[chosen[own]]))
    back = torch.empty_like(depth)
    back[torch.cat(order)] = torch.arange(len(depth), device=depth.device)
    return rows(joined(parts), back)


def with_light(integrand: Integrand, path: IdealPath, looks: LightLooks) -> IdealPath:
    """The paths, with `LIT` where they end after at least one ideal vertex."""
    found = list(path)
    for number, (place, met) in enumerate(path[1:integrand.max_depth - 1], 1):
        lane = (place >= 0).nonzero().squeeze(1)  # in the order of `met`
        ends = (((met.what & ONWARDS) == 0) & (met.hit.prim >= 0) & looks.sharp[lane]).nonzero().squeeze(1)
        if len(ends):
            draw = rows(looks.draw, lane[ends])
            ray, distance = to_light(integrand.proposal, *rows((met.ray, met.hit), ends), draw)
            lit = torch.where(integrand.caster.occluded(ray, distance), 0, LIT).to(met.what.dtype)
            found[number] = Vertices(place, met._replace(what=met.what.index_add(0, ends, lit)))
    return tuple(found)


def to_light(scene: SceneTensors, ray: Ray, hit: Hit, draw: LightDraw) -> tuple[Ray, Tensor]:
    """The rays from what rays meet towards light samples, and how far, (N,); detached."""
    si = surface_interaction(scene, ray, hit)
    _, d, _ = light_line(scene, si.p.map(torch.Tensor.double), draw)
    # It aims from where it starts, off the surface, as shadow rays do: else the two would not agree beside a border.
    start = si.offset((-d).map(lambda c: c.to(scene.dtype)))
    _, d, parallel = light_line(scene, start.map(torch.Tensor.double), draw)
    length = torch.sqrt(dot(d, d))
    towards = (d * (-1.0 / length)).map(lambda c: c.to(scene.dtype))
    return Ray(start, towards), torch.where(parallel, FAR, length * (1.0 - BEFORE)).to(scene.dtype)
