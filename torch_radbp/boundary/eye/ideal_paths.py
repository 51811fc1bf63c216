"""Camera paths through ideal mirrors and glass, up to the first vertex that scatters otherwise."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.eye.ideal_steps import LIT, ONWARDS, Reached, steps_taken
from torch_radbp.boundary.eye.light_points import aims_at, light_line, line_of
from torch_radbp.boundary.eye.seen_edges import BEFORE, FAR
from torch_radbp.boundary.eye.surfaces import Surfaces
from torch_radbp.path.direct_light import LightDraw
from torch_radbp.path.event import Ends
from torch_radbp.path.integrand import Integrand
from torch_radbp.path.sorting import appearances_met
from torch_radbp.path.state import PathState
from torch_radbp.path.step import Onward
from torch_radbp.raycast.protocol import Hit
from torch_radbp.scene.tables.scene_tensors import SceneTensors
from torch_radbp.tensors.record import joined
from torch_radbp.tensors.stage import stage
from torch_radbp.tensors.vec import Ray, dot, rows
from torch_radbp.vertex.interaction import shading_normal, surface_interaction

MOST_VERTICES = 16  # of a path that are looked at
NO_ROULETTE = 1 << 30
GRAZING = 1e-3  # sine of the angle between surface and light up to which the latter does not count


class Vertices(NamedTuple):
    """One vertex of each of N paths, behind the same number of vertices at ideal mirrors and glass."""

    place: Tensor  # (N,) int32, index of the path among the M that come so far; -1: it ends before
    met: Reached


class LightLooks(NamedTuple):
    """N light samples, and whether their shadow borders are searched."""

    draw: LightDraw
    wanted: Tensor  # (N,) bool: borders of its shadow are looked for
    anywhere: Tensor  # (N,) bool: after any number of ideal vertices; else after one


IdealPath = tuple[Vertices, ...]  # vertex by vertex, from what the camera sees on


def only_ideal(integrand: Integrand) -> Integrand:
    """The integrand that follows ideal vertices only: without light sampling and Russian roulette."""
    return integrand._replace(settings=integrand.settings._replace(nee=False), rr_depth=NO_ROULETTE,
                              max_depth=min(integrand.max_depth, MOST_VERTICES))


def ideal_at_first(integrand: Integrand) -> Integrand:
    """The integrand in which only ideal lobes count at first vertices, if materials have other lobes, too.

    What is reflected by a coat is discontinuous; what its base scatters is not, and paths that sample it would be wasted.
    """
    coated = any(look.kind.delta and look.kind.smooth for look in integrand.scene.layout.appearances)
    return integrand._replace(settings=integrand.settings._replace(ideal=coated))


def ideal_path(integrand: Integrand, start: PathState, surfaces: Surfaces) -> IdealPath:
    """Follows paths to the first vertex that does not scatter ideally, to a miss, or to the last bounce.

    Args:
        integrand: from `only_ideal`, of a detached scene.
        start: (N,) the initial path states, lanes in order.
        surfaces: of the scene, prepared for the stages.
    """
    found, onward = [], Onward(start, None)
    with steps_taken(integrand, surfaces, start) as step:
        for depth in range(integrand.max_depth):
            if onward is None or not onward.count:
                break
            lane, met, onward = step(onward, depth)
            place = lane
            if depth:
                place = torch.full_like(start.lane, -1)
                place[lane.long()] = torch.arange(len(lane), dtype=torch.int32, device=lane.device)
            found.append(Vertices(place, met))
    return tuple(found)


def some_paths(path: IdealPath, chosen: Tensor) -> IdealPath:
    """Selects paths by index, (M,) int64, in this order; cut to the length of the longest."""
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
    """Concatenates two sets of paths."""
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
    """(N,) bool: paths whose first hit is an ideal surface."""
    return (path[0].met.what & ONWARDS) > 0


def along(path: IdealPath, chosen: Tensor, depth: Tensor) -> Reached:
    """The hits of selected paths, (K,), each after a given number of vertices, (K,) int64."""
    parts, order = [], []
    for number, (place, met) in enumerate(path):
        own = (depth == number).nonzero().squeeze(1)
        order.append(own)
        parts.append(rows(met, place[chosen[own]]))
    back = torch.empty_like(depth)
    back[torch.cat(order)] = torch.arange(len(depth), device=depth.device)
    return rows(joined(parts), back)


def with_light(integrand: Integrand, path: IdealPath, looks: LightLooks) -> IdealPath:
    """The paths, with `LIT` set at vertices after an ideal one at which an unoccluded light sample is scattered back."""
    found = list(path)
    for number, (place, met) in enumerate(path[1:integrand.max_depth - 1], 1):
        lane = (place >= 0).nonzero().squeeze(1)  # in the order of `met`
        wanted = (looks.wanted if number == 1 else looks.wanted & looks.anywhere)[lane]
        widely, transmits = kinds_met(integrand, met)
        shown = (widely & wanted).nonzero().squeeze(1)
        if len(shown):
            own, through = rows((met, transmits), shown)
            way = to_light(integrand, own, rows(looks.draw, lane[shown]))
            lit = (way.reflected | way.transmitted & through) & ~integrand.caster.occluded(way.ray, way.length)
            lit = torch.where(lit, LIT, 0).to(met.what.dtype)
            found[number] = Vertices(place, met._replace(what=met.what.index_add(0, shown, lit)))
    return tuple(found)


def kinds_met(integrand: Integrand, met: Reached) -> tuple[Tensor, Tensor]:
    """(M,) bool: hits of surfaces with a lobe that is not ideal; and (M,) bool: hits of surfaces that transmit light."""
    layout, (number, _) = integrand.proposal.layout, appearances_met(integrand, met.ray, met.hit)
    others = [False] * (len(layout.scattering_media) + 1)
    flags = ([look.kind.smooth for look in layout.appearances], [look.kind.transmits for look in layout.appearances])
    return tuple(rows(torch.tensor(of_kinds + others, device=number.device), number) for of_kinds in flags)


class LightWay(NamedTuple):
    """The shadow rays from N hits to light samples; detached."""

    ray: Ray  # of the shadow
    length: Tensor
    reflected: Tensor  # bool: what the light sends there arrives on the side that is seen
    transmitted: Tensor  # bool: it arrives on the other side


def to_light(integrand: Integrand, met: Reached, draw: LightDraw) -> LightWay:
    """The shadow rays from hits to light samples, (N,); `integrand`: with a detached scene."""
    return integrand.part(Ends.SURROUNDINGS).call(way_to_light, met.ray, met.hit, draw)


@stage("scene")
def way_to_light(scene: SceneTensors, ray: Ray, hit: Hit, draw: LightDraw) -> LightWay:
    """The shadow rays from hits to light samples; light at grazing angles does not count, where rounding would decide.

    Args:
        scene: any part of it, detached.
        ray, hit: (N,) the rays and what they hit.
        draw: (N,) the light samples.
    """
    si = surface_interaction(scene, ray, hit)
    _, d, _ = light_line(scene, si.p.map(torch.Tensor.double), draw)
    # It aims from where it starts, off the surface, as shadow rays do: else the two would not agree beside a border.
    start = si.offset((-d).map(lambda c: c.to(scene.dtype)))
    aims, p = aims_at(scene, start.map(torch.Tensor.double), draw), start.map(torch.Tensor.double)
    _, d, parallel = line_of(aims, p)
    length = torch.sqrt(dot(d, d))
    towards = (d * (-1.0 / length)).map(lambda c: c.to(scene.dtype))
    rise, shaded = (-dot(n, towards) * torch.sign(dot(n, ray.d)) for n in (si.n, shading_normal(scene, hit, si.n)))
    sent = (aims("pdf") > 0.0) & (rise.abs() > GRAZING)
    return LightWay(Ray(start, towards), torch.where(parallel, FAR, length * (1.0 - BEFORE)).to(scene.dtype),
                    sent & (rise > 0.0) & (shaded > 0.0), sent & (rise < 0.0))
