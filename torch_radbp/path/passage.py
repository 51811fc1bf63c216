"""The ways of rays through media: where paths scatter before they meet a surface, and what a way leaves of light.

A ray passes boundaries that are surfaces of BSDF `null` straight, from one medium into the next, until it meets a surface
that scatters, or a flight ends in a medium. Passing is no bounce: the hit that is left is that of the last surface, as far
from where the ray began as it is, and the way is told by its lengths in each of the media. Of those that are the same
everywhere that is all that the transmittance depends on, and its derivative. In others rays are followed from collision to
collision: what is left of light is an estimate then, and a point that is picked evenly on the way tells the derivative
(`MediumWay`). Other surfaces that let light pass straight are passed by chance (`panes.py`). So are connections to lights
followed (`shadow_passage.py`).

In each medium the same random number decides anew how far the path flies, of which passing has used up a part.

Reference: Pharr, Jakob and Humphreys 2023, "Physically Based Rendering", section 14.2.2.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torch_radbp.connection.light import FAR
from torch_radbp.connection.media import transmittance, transmittance_of
from torch_radbp.interface.medium import EmissionCandidate, MediumKind, MediumWay, Tracking, colour_chosen, mean_of_colours
from torch_radbp.path.panes import no_panes, pane_at, through_panes, with_pane
from torch_radbp.path.state import BSDF_CHOICE, Arrival, BoundaryCrossing, Flight, PathState, Position
from torch_radbp.raycast.protocol import Hit
from torch_radbp.sampling.sampler import BounceKey, bounce_key, hash32, next_number, uniform
from torch_radbp.scene.tables.placement import points_in_world
from torch_radbp.scene.tables.scene_tensors import SAME, SceneTensors
from torch_radbp.scene.tables.triangle_corners import at_corners, edges
from torch_radbp.tensors.differentiated import detached, settled
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.stage import stage
from torch_radbp.tensors.vec import TINY, Ray, Vec3, cross, dot, rows, where
from torch_radbp.vertex.interaction import corner_rows, surface_interaction

SALT = 0x1B873593  # tells the random numbers of flights from those of bounces
NEXT_SEGMENT = 0x2545F491  # added to seeds after a segment
FLIGHT_U, FLIGHT_V = range(2)
ALMOST_ONE = 1.0 - 1e-7
LONGEST_WAY = 0.1 * FAR  # connections beyond it end at no lamp nearby


class PathPassage(NamedTuple):
    """The state of rays that pass through media, (N,) each, at the start of a segment between two boundaries."""

    ahead: Ray  # how it goes on from there
    u: Tensor  # what is left of the random number of distances
    v: Tensor  # the random number that chooses a colour
    seed: Tensor  # int32, of the random numbers of steps
    beyond: Vec3  # probability of having come so far without scattering, by the colour that is chosen
    flight: Flight  # what is known of it so far


@stage("scene")
def way_begun(scene: SceneTensors, state: PathState, at: Position) -> PathPassage:
    """The passages of paths before their first segment; args as for `free_flight`."""
    # What decides whether there is a flight at all has a point of its own, beside that of the direction that follows.
    key, ray = bounce_key(state.key, at.counter + SALT), detached(state.ray)
    u, v = (uniform(key, dimension, state.pdf.dtype) for dimension in (FLIGHT_U, FLIGHT_V))
    none = torch.zeros_like(u)
    flight = Flight(none, none, state.medium, ways_at_first(scene, none))
    if scene.layout.panes:
        choice = uniform(bounce_key(state.key, at.counter), BSDF_CHOICE, u.dtype)
        flight = flight._replace(panes=no_panes(scene, none), stays=torch.ones_like(u), choice=choice)
    return PathPassage(ray, u, v, steps_seed(key), Vec3.full(u, 1.0), flight)


def ways_at_first(scene: SceneTensors, none: Tensor) -> tuple[MediumWay, ...]:
    """For each medium the way through it before a ray's first segment, of length 0; `none`: (N,) zeros."""
    return tuple(MediumWay(none, Vec3.full(none, 1.0), none) if kind.heterogeneous else MediumWay(none)
                 for kind in scene.layout.media)


def steps_seed(key: BounceKey) -> Tensor:
    """(N,) int32, a seed of random numbers for each lane, from the key of a bounce."""
    return hash32(key.shift ^ hash32(key.first))


@stage("scene")
def tracking_begun(scene: SceneTensors, ahead: Ray, segment: Tensor, medium: Tensor, seed: Tensor, shadow: bool) -> Tracking:
    """The start of delta tracking along segments of rays; rays run that are in a heterogeneous medium.

    Args:
        scene: detached; any part of it.
        ahead: (N,) rays.
        segment: (N,) distances to the next surface.
        medium: (N,) int32, numbers of the media.
        seed: (N,) int32, of random numbers.
        shadow: shadow rays, which collect no emission.
    """
    first, last = torch.zeros_like(segment), torch.zeros_like(segment)
    for number in scene.layout.heterogeneous_media:
        here, span = medium == number, scene.layout.media[number].enter(scene.media[number], ahead, segment)
        first, last = (torch.where(here, new, old) for new, old in zip(span, (first, last)))
    whole = Vec3.full(segment, 1.0)
    emission = None if shadow or not scene.layout.emitting_media else EmissionCandidate(first, whole, whole)
    return Tracking(first, torch.full_like(segment, torch.inf), whole, Vec3.full(segment, 1.0), seed, first < last, emission)


@stage("scene")
def is_tracked_in(scene: SceneTensors, tracking: Tracking, medium: Tensor, number: int) -> Tensor:
    """(N,) bool: rays still run in heterogeneous medium `number`; args as for `tracking_begun`."""
    return tracking.running & (medium == number)


@stage("scene", "ahead", "segment", "v", "tracking", repeats="tracking")
def tracking_on(scene: SceneTensors, ahead: Ray, segment: Tensor, v: Tensor, tracking: Tracking, lanes: Tensor, number: int,
                flies: bool) -> Tracking:
    """Takes some steps of delta tracking for M of N rays; on a GPU all steps. See `MediumKind.track`.

    Args:
        scene: detached; any part of it.
        ahead, segment, v, tracking: (N,).
        lanes: (M,) int32, the rays.
        number: the medium's.
        flies: rays may scatter.
    """
    ahead, segment, v, tracking = rows((ahead, segment, v, tracking), lanes)
    return scene.layout.media[number].track(scene.media[number], ahead, segment, v, tracking, flies)


@stage("scene", "ahead", "medium")
def surface_ahead(scene: SceneTensors, ahead: Ray, medium: Tensor, hit: Hit, lanes: Tensor) -> Tensor:
    """The distances to the surfaces that rays hit, (M,); 1e10 where they hit none. Args as for `next_segment`; `ahead`,
    `medium`: (N,) of the passage."""
    ahead, medium = rows((ahead, medium), lanes)
    met = hit.prim >= 0
    length = torch.where(met, dot(surface_interaction(scene, ahead, hit).p - ahead.o, ahead.d), FAR).clamp_min(0.0)
    return in_enclosed(scene, medium, met, length)


def in_enclosed(scene: SceneTensors, medium: Tensor, met: Tensor, length: Tensor) -> Tensor:
    """Segment lengths, (N,), set to 0 where a ray in an enclosed medium hits nothing: it has slipped out by rounding.

    Args:
        medium: (N,) int32, numbers of the media.
        met: (N,) bool: there is a surface ahead.
        length: (N,) the lengths otherwise.
    """
    for number in scene.layout.enclosed_media:
        length = torch.where((medium == number) & ~met & (length > LONGEST_WAY), 0.0, length)
    return length


def with_segment(scene: SceneTensors, ways: tuple[MediumWay, ...], medium: Tensor,
                 segment: Segment) -> tuple[MediumWay, ...]:
    """Adds a segment to the ways through each medium; `medium`: (N,) int32, the number of the medium of the segment."""
    extended_ways = []
    for number, (kind, table, way) in enumerate(zip(scene.layout.media, scene.media, ways)):
        here = medium == number
        if not kind.heterogeneous:
            extended_ways.append(MediumWay(way.length + torch.where(here, segment.last, 0.0)))
            continue
        # Pick a point evenly on all of the way: on this segment with the probability of its share.
        first, last = kind.enter(table, segment.ahead, segment.length)
        length = torch.where(here, (torch.minimum(last, segment.last) - first).clamp_min(0.0), 0.0)
        total = way.length + length
        seed, on_segment = next_number(segment.tracking.seed, length.dtype)
        _, share = next_number(seed, length.dtype)
        place = torch.where(on_segment * total < length, segment.come + first + share * length, way.place)
        extended_ways.append(MediumWay(total, where(here, way.left * segment.tracking.left, way.left), place))
    return tuple(extended_ways)


class Segment(NamedTuple):
    """A segment of a ray through one medium, (N,) each."""

    ahead: Ray
    come: Tensor  # distance from where the way began to where the segment does
    length: Tensor  # to the next surface; 1e10 where there is none
    last: Tensor  # to where it ends
    tracking: Tracking | None  # where it ended in a heterogeneous medium; None: there is none


@stage("scene", "ray", "way")
def next_segment(scene: SceneTensors, ray: Ray, way: PathPassage, hit: Hit, tracking: Tracking | None, lanes: Tensor,
             flies: bool) -> tuple[Hit, PathPassage, Tensor]:
    """Follows rays through one medium: to where they scatter, to a surface, or through a boundary into the next.

    Args:
        scene: detached; any part of it.
        ray: (N,) the rays from their first origins.
        way: (N,) the passages so far.
        hit: (M,) what the rays `way.ahead` hit.
        tracking: (M,) the result of delta tracking; None: no medium is heterogeneous.
        lanes: (M,) int32, the rays that are followed.
        flies: paths may scatter in media; else they go straight to the next surface.

    Returns:
        (M,) hits with distances from the first origins, passages, and whether rays go on behind a boundary.
    """
    ray, way = rows((ray, way), lanes)
    si, met, d, flight = surface_interaction(scene, way.ahead, hit), hit.prim >= 0, way.ahead.d, way.flight
    come = dot(way.ahead.o - ray.o, d)
    length = in_enclosed(scene, flight.medium, met, torch.where(met, dot(si.p - way.ahead.o, d), FAR).clamp_min(0.0))
    # Fly through the medium: the distance to where the path scatters, and the probabilities of all that.
    end, density, beyond = torch.full_like(length, torch.inf), Vec3.full(length, 0.0), Vec3.full(length, 1.0)
    for number in scene.layout.scattering_media if flies else ():
        kind, table, here = scene.layout.media[number], scene.media[number], flight.medium == number
        if kind.heterogeneous:
            distance, of_flight, farther = tracking.end, tracking.beyond, tracking.beyond
        else:
            distance = kind.sample_flight(table, way.ahead, length, way.u, way.v)
            of_flight, farther = kind.flight_pdf(table, way.ahead, length, torch.minimum(distance, length))
        end = torch.where(here & (distance < length), distance, end)
        density, beyond = where(here, of_flight, density), where(here, farther, beyond)
    scatters = end < torch.inf
    segment = Segment(way.ahead, come, length, torch.minimum(end, length), tracking)
    ways = with_segment(scene, flight.ways, flight.medium, segment)
    # Go on behind the surface, if it is but a boundary, or if what lets light pass straight is chosen among its lobes.
    row, seed, beyond_it = lookup(scene.triangles.boundary, si.prim), next_seed(way.seed, tracking), way.beyond * beyond
    passes, panes, stays, choice = lookup(scene.boundaries.invisible, row), flight.panes, flight.stays, flight.choice
    if panes is not None:
        pane = pane_at(scene, ray, hit, choice)
        passes_pane = met & ~scatters & pane.chosen
        seed, panes = with_pane(panes, hit, pane.through, passes_pane, seed)
        beyond_it = beyond_it * torch.where(passes_pane, pane.chance, 1.0)
        stays = torch.where(met & ~scatters & ~passes_pane, 1.0 - pane.chance, 1.0)
        seed, choice_next = next_number(seed, choice.dtype)
        passes, choice = passes | passes_pane, torch.where(passes_pane, choice_next, choice)
    passes = met & ~scatters & passes
    medium = torch.where(passes, medium_beyond(scene, si.prim, si.cosine, flight.medium), flight.medium)
    used = 1.0 - colour_chosen(beyond, way.v)  # by flights that would have ended before
    u = ((way.u - used) / (1.0 - used).clamp_min(TINY)).clamp(0.0, ALMOST_ONE)
    chance = mean_of_colours(way.beyond * where(scatters, density, beyond))
    flight = Flight(torch.where(scatters, come + end, torch.inf), chance, medium, ways, None, panes, stays, choice)
    way = PathPassage(Ray(si.offset(d), d), u, way.v, seed, beyond_it, flight)
    return hit._replace(t=torch.where(met, come + length, hit.t)), way, passes


def next_seed(seed: Tensor, tracking: Tracking | None) -> Tensor:
    """(N,) int32, the seeds of random numbers for the next segment."""
    return hash32((seed if tracking is None else tracking.seed) + NEXT_SEGMENT)


@stage("scene")
def free_flight(scene: SceneTensors, state: PathState, hit: Hit, at: Position) -> Flight:
    """Samples how far paths come in a medium that fills all space.

    Args:
        scene: detached; any part of it.
        state, hit: the paths that reach a bounce, and what their rays meet.
        at: the depth.
    """
    number, begun = scene.layout.around, way_begun(scene, state, at)
    kind, table, way = scene.layout.media[number], scene.media[number], torch.where(hit.prim >= 0, hit.t, FAR)
    t = kind.sample_flight(table, begun.ahead, way, begun.u, begun.v)
    scatters = t < way
    density, beyond = map(mean_of_colours, kind.flight_pdf(table, begun.ahead, way, torch.minimum(t, way)))
    return Flight(settled(torch.where(scatters, t, torch.inf)), settled(torch.where(scatters, density, beyond)))


def medium_beyond(scene: SceneTensors, prim: Tensor, cosine: Tensor, medium: Tensor) -> Tensor:
    """The numbers of the media into which rays leave surfaces, (N,) int32.

    Args:
        scene: detached; any part of it.
        prim: (N,) int32, triangles of the surfaces.
        cosine: (N,) between the geometric normal and the ray.
        medium: (N,) int32, the medium before the surface, which goes on behind surfaces that bound none.
    """
    row = lookup(scene.triangles.boundary, prim)
    side = torch.where(cosine > 0, lookup(scene.boundaries.outside, row), lookup(scene.boundaries.inside, row))
    return torch.where(side == SAME, medium, side)


@stage("scene")
def no_crossing(scene: SceneTensors, like: Tensor) -> BoundaryCrossing:
    """The record of a crossing of a medium's boundary for N rays that pass none.

    Args:
        scene: any part of it.
        like: (N,) gives the dtype.
    """
    none, number = torch.zeros_like(like), torch.zeros_like(like, dtype=torch.int32)
    instance = None if scene.triangles.instances is None else number
    return BoundaryCrossing(Hit(number - 1, none, none, none, instance), number, number)


def moved_ways(scene: SceneTensors, ray: Ray, ways: tuple[MediumWay, ...], crossings: tuple[BoundaryCrossing, ...],
               medium: Tensor, distance: Tensor) -> tuple[MediumWay, ...]:
    """Ways through media with lengths that are attached to the rays, the boundaries that they pass, and their ends.

    Args:
        scene, ray: attached.
        ways: through each of `Layout.media`, (N,).
        crossings: of the boundaries, in the order in which rays pass them.
        medium: (N,) int32, numbers of the media in which they end.
        distance: (N,) attached, to the end.
    """
    changes = [(medium, distance - settled(distance))]  # of lengths, by the numbers of media
    borders = [distance_passed(scene, ray, crossing.hit) for crossing in crossings]
    for crossing, border in zip(crossings, borders):
        change = torch.where(settled(border) < torch.inf, border - settled(border), 0.0)
        changes += [(crossing.before, change), (crossing.after, -change)]
    moved = []
    for number, (kind, way) in enumerate(zip(scene.layout.media, ways)):
        if kind.heterogeneous:
            moved.append(moved_way(kind, scene.media[number], ray, way, borders, distance))
            continue
        length = way.length
        for of_medium, change in changes:
            length = length + torch.where(of_medium == number, change, 0.0)
        moved.append(way._replace(length=length))
    return tuple(moved)


def moved_way(kind: MediumKind, table: Any, ray: Ray, way: MediumWay, borders: Sequence[Tensor],
              distance: Tensor) -> MediumWay:
    """The way through a heterogeneous medium, attached: its picked point keeps its share of the segment that it lies on, and
    its weight changes with the length of the segment.

    Args:
        kind, table: the medium.
        borders: (N,) each, attached, where rays pass boundaries; infinite: they do not.
        ray, way, distance: as for `moved_ways`.
    """
    first, segment = segment_inside(kind, table, ray, *segment_around(way.place, borders, distance))
    longer = segment / settled(segment)
    return way._replace(length=way.length * longer, place=first + (way.place - settled(first)) * longer)


def segment_around(place: Tensor, borders: Sequence[Tensor], distance: Tensor) -> tuple[Tensor, Tensor]:
    """The distances at which segments that contain `place` begin and end, (N,) each, attached; args as for `moved_way`."""
    begins, ends = torch.zeros_like(distance), distance
    for border in borders:
        before = settled(border) <= place
        begins = torch.where(before & (settled(border) > settled(begins)), border, begins)
        ends = torch.where(~before & (settled(border) < settled(ends)), border, ends)
    return begins, ends


def segment_inside(kind: MediumKind, table: Any, ray: Ray, begins: Tensor, ends: Tensor) -> tuple[Tensor, Tensor]:
    """The distance at which segments of rays enter the volume of a heterogeneous medium, and their length inside, (N,) each,
    attached; length 1 for segments outside."""
    first, last = kind.enter(table, ray, ends)
    first = torch.where(begins > first, begins, first)
    return first, torch.where(settled(last - first) > TINY, last - first, 1.0)


def distance_passed(scene: SceneTensors, ray: Ray, hit: Hit) -> Tensor:
    """The distances at which rays cross the planes of hit triangles, (N,), attached to both; infinite for misses."""
    p0, e1, e2 = edges(*points_in_world(scene, hit, at_corners(scene.triangles.vertices.p, corner_rows(scene, hit))))
    n = cross(e1, e2)
    facing = dot(n, ray.d)
    passes = (hit.prim >= 0) & (facing.abs() > TINY)
    return torch.where(passes, dot(n, p0 - ray.o) / torch.where(passes, facing, 1.0), torch.inf)


def way_left(scene: SceneTensors, arrival: Arrival, distance: Tensor) -> Vec3 | None:
    """The transmittance of media along path segments, (N,), attached; None: there are no media.

    Args:
        arrival: the paths, with their ways through media.
        distance: (N,) attached length of the whole way.
    """
    if scene.layout.traces_segments:
        flight, ways = arrival.flight, arrival.flight.ways
        if flight.crossings is not None:
            ways = moved_ways(scene, arrival.state.ray, ways, flight.crossings, flight.medium, distance)
        left = transmittance_of(scene, arrival.state.ray, ways)
        return through_panes(scene, left, arrival.state.ray, flight.panes, flight.crossings is not None)
    return transmittance(scene, arrival.state.ray, distance)


def way_through(scene: SceneTensors, arrival: Arrival, distance: Tensor) -> Vec3 | None:
    """The factor of light that surfaces reflect back along rays through media, (N,); None: there are no media.

    In a medium that scatters only some flights reach the surface, so that those count by transmittance over the probability
    to get there. Args as for `way_left`.
    """
    left = way_left(scene, arrival, distance)
    return left if arrival.flight is None else left / settled(arrival.flight.chance).clamp_min(TINY)


def shown_through(arrival: Arrival, through: Vec3 | None) -> Vec3 | None:
    """The factor, (N,), of emission and next-event estimates at surfaces: paths that passed these straight do not see them.

    Args:
        arrival: the paths.
        through: the result of `way_through`.
    """
    stays = None if arrival.flight is None else arrival.flight.stays
    return through if stays is None else through / stays.clamp_min(TINY)
