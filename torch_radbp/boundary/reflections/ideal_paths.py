"""Camera paths as far as they are scattered ideally: reflected by mirrors, refracted by glass, into single directions."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.reflections.surfaces import LineTable, cells_met
from torch_radbp.boundary.shadows.light_points import light_line
from torch_radbp.boundary.shadows.seen_edges import BEFORE, FAR
from torch_radbp.path.bounce import Vertex
from torch_radbp.path.direct_light import LightDraw
from torch_radbp.path.integrand import Integrand
from torch_radbp.path.queues import Queue
from torch_radbp.path.state import PathState
from torch_radbp.path.wavefront import Step, bounce_queues, first_hit, queued
from torch_radbp.raycast.protocol import Hit
from torch_radbp.scene.interaction import shading_normal, surface_interaction, triangle_normal
from torch_radbp.scene.tensors import SceneTensors
from torch_radbp.tensors.record import leaves_of, with_leaves
from torch_radbp.tensors.vec import Ray, dot, max_component, rows

MOST_VERTICES = 16  # of a path that are looked at
NO_ROULETTE = 1 << 30


class Reached(NamedTuple):
    """What N paths meet after a number of ideal vertices; detached, of no meaning where a path ends before."""

    here: Tensor  # (N,) bool: the path comes so far
    ray: Ray
    hit: Hit
    front: Tensor  # (N,) bool: it meets the side of the shading normal
    onwards: Tensor  # (N,) bool: it is scattered ideally, and goes on
    through: Tensor  # (N,) bool: to the other side of the shading normal
    outside: Tensor  # (N,) bool: it goes on on the side of the triangle's own normal
    lit: Tensor  # (N,) bool: it ends on a surface that the light of a sample reaches
    cells: tuple[Tensor, ...]  # (N,) each, from `cells_met`


class LightLooks(NamedTuple):
    """Light samples, N, from which shadows are looked for."""

    draw: LightDraw
    sharp: Tensor  # (N,) bool: of light without extent; others are left out


IdealPath = tuple[Reached, ...]  # vertex by vertex, from what the camera sees on


def only_ideal(integrand: Integrand) -> Integrand:
    """The integrand by which ideal vertices are followed: light is not looked for, and no path is ended by chance."""
    return integrand._replace(settings=integrand.settings._replace(nee=False), rr_depth=NO_ROULETTE,
                              max_depth=min(integrand.max_depth, MOST_VERTICES))


def ideal_path(integrand: Integrand, start: PathState, lines: LineTable | None) -> IdealPath:
    """Follows paths until they meet something that does not scatter ideally, or nothing; at most to their last vertex.

    Args:
        integrand: from `only_ideal`, of a detached scene.
        start: (N,) of the paths, lanes in order.
        lines: of textures.
    """
    found, state = [], start
    for depth in range(integrand.max_depth):
        if not len(state.lane):
            break
        hit = first_hit(integrand, state.ray, depth)
        lanes, vertex = ideally_scattered(integrand, state, hit, depth)
        n = triangle_normal(integrand.proposal, hit)
        shading = shading_normal(integrand.proposal, hit, n)
        cosine, own = dot(shading, state.ray.d), lanes.long()
        onwards, through, outside = (torch.zeros_like(hit.prim, dtype=torch.bool) for _ in range(3))
        if len(lanes):
            d = vertex.next.ray.d
            goes_on = torch.isinf(vertex.next.pdf) & vertex.survives & (max_component(vertex.F) > 0)
            onwards[own] = goes_on
            through[own] = goes_on & (dot(rows(shading, own), d) * cosine[own] > 0)
            outside[own] = goes_on & (dot(rows(n, own), d) > 0)
        met = Reached(torch.ones_like(onwards), state.ray, hit, (cosine < 0) | (hit.prim < 0), onwards, through, outside,
                      torch.zeros_like(onwards), cells_met(integrand.proposal, lines, hit))
        found.append(met if depth == 0 else scattered_to(met, state.lane, len(start.lane)))
        if not len(lanes):
            break
        state = rows(vertex.next, goes_on.nonzero().squeeze(1))
    return tuple(found)


def ideally_scattered(integrand: Integrand, state: PathState, hit: Hit, depth: int) -> tuple[Tensor, Vertex | None]:
    """The lanes that may be scattered ideally, (M,) int32, and their vertices; None if there are none, or paths end."""
    front, order, queues = queued(integrand, state.ray, hit, integrand.is_last(depth))
    ideal = [queue for queue in queues if queue.event.scatters and integrand.scatterer(queue.event).kind.delta]
    if not ideal:
        return order[:0], None
    order = torch.cat([order[queue.first:queue.last] for queue in ideal])
    packed, first = [], 0
    for queue in ideal:
        last = first + queue.last - queue.first
        packed.append(Queue(queue.event, first, last, last))
        first = last
    undecided = hit.prim.new_empty(0, dtype=torch.bool)
    step = Step(hit, front, order, tuple(packed), undecided, undecided, texture_values=(None,) * len(packed))
    vertex, _ = bounce_queues(integrand, state, depth, step, with_light=False)
    return order, vertex


def scattered_to(record, lane: Tensor, count: int):
    """Rows of a record as those `lane`, (M,) int32, of `count`, the others 0."""
    place = lane.long()
    return with_leaves(record, [None if leaf is None else leaf.new_zeros(count).index_copy(0, place, leaf)
                                for leaf in leaves_of(record)])


def either(condition: Tensor, first: IdealPath, second: IdealPath) -> IdealPath:
    """Row by row the first paths where the condition holds, else the second."""
    longer, shorter = (first, second) if len(first) >= len(second) else (second, first)
    nowhere = [with_leaves(met, [None if leaf is None else torch.zeros_like(leaf) for leaf in leaves_of(met)])
               for met in longer[len(shorter):]]
    shorter = (*shorter, *nowhere)
    first, second = (longer, shorter) if len(first) >= len(second) else (shorter, longer)
    return tuple(with_leaves(one, [None if a is None else torch.where(condition, a, b)
                                   for a, b in zip(leaves_of(one), leaves_of(other))])
                 for one, other in zip(first, second))


def begins(path: IdealPath) -> Tensor:
    """(N,) bool: the camera sees an ideal surface."""
    return path[0].onwards


def along(path: IdealPath, depth: Tensor) -> Reached:
    """What paths meet after so many vertices each, (N,) int64."""
    found = path[0]
    for number, met in enumerate(path[1:], 1):
        own = depth == number
        found = with_leaves(found, [None if a is None else torch.where(own, b, a)
                                    for a, b in zip(leaves_of(found), leaves_of(met))])
    return found


def with_light(integrand: Integrand, path: IdealPath, looks: LightLooks) -> IdealPath:
    """The paths, with `Reached.lit` where they end after at least one ideal vertex."""
    found = list(path)
    for number, met in enumerate(path[1:integrand.max_depth - 1], 1):
        ends = (met.here & ~met.onwards & (met.hit.prim >= 0) & looks.sharp).nonzero().squeeze(1)
        if len(ends):
            ray, distance = to_light(integrand.proposal, *rows((met.ray, met.hit, looks.draw), ends))
            free = ~integrand.caster.occluded(ray, distance)
            found[number] = met._replace(lit=met.lit.index_copy(0, ends, free))
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
