"""The loops that trace rays through media, segment by segment from boundary to boundary; `passage.py` has one segment."""

from __future__ import annotations

from torch import Tensor

from torch_radbp.connection.media import transmittance_of
from torch_radbp.interface.medium import Tracking
from torch_radbp.jit.order import all_lanes, chosen, duplicated, inverted, repeated
from torch_radbp.path.bounce import Vertex
from torch_radbp.path.event import Ends
from torch_radbp.path.integrand import Integrand
from torch_radbp.path.lane_room import power_of_2
from torch_radbp.path.lanes import put_rows
from torch_radbp.path.panes import through_panes
from torch_radbp.path.passage import (
    PathPassage,
    free_flight,
    is_tracked_in,
    moved_ways,
    next_segment,
    no_crossing,
    surface_ahead,
    tracking_begun,
    tracking_on,
    way_begun,
)
from torch_radbp.path.shadow_passage import next_shadow_segment, shadow_ahead, shadow_begun
from torch_radbp.path.state import BoundaryCrossing, Flight, PathState, ShadowWay
from torch_radbp.path.volume_emission import emission_begun, emission_on_segment
from torch_radbp.raycast.protocol import Hit
from torch_radbp.sampling.sampler import LaneKey
from torch_radbp.scene.tables.scene_tensors import SceneTensors
from torch_radbp.tensors.differentiated import detached
from torch_radbp.tensors.record import mapped
from torch_radbp.tensors.stage import stage
from torch_radbp.tensors.vec import Ray, Vec3, rows


def free_flights(integrand: Integrand, state: PathState, hit: Hit, depth: int) -> tuple[Hit, Flight | None]:
    """Follows paths through media: the surfaces hit, and how far paths come before they scatter, None without media.

    Args:
        integrand: the scene.
        state, hit: the paths that reach a bounce, and what their rays meet first, (N,).
        depth: of the bounce.
    """
    layout, flies = integrand.proposal.layout, not integrand.is_last(depth)
    if not layout.traces_segments and not (layout.scattering_media and flies):
        return hit, None
    part, at, state = integrand.part(Ends.SURROUNDINGS), integrand.at(depth), detached(state)
    if not layout.traces_segments:
        return hit, part.call(free_flight, state, hit, at)
    way, pick = part.call(way_begun, state, at), integrand.stages(rows)
    if layout.emitting_media:
        way = way._replace(flight=way.flight._replace(emission=part.call(emission_begun, state)))

    def flown(met: Hit, lanes: Tensor) -> tuple[Hit, PathPassage, Tensor]:
        """Follows rays through one medium, and through the surface behind if it is a boundary; results as of
        `next_segment`."""
        tracking = None
        if layout.heterogeneous_media:
            length = part.call(surface_ahead, way.ahead, way.flight.medium, met, lanes)
            begun = pick((way.ahead, way.flight.medium, way.seed, way.v), lanes)
            tracking = tracking_ended(integrand, *begun, length, flies)
        hit, on, passes = part.call(next_segment, state.ray, way, met, tracking, lanes, flies)
        if layout.emitting_media:
            emission = part.call(emission_on_segment, state.ray, way, met, tracking, lanes)
            on = on._replace(flight=on.flight._replace(emission=emission))
        return hit, on, passes

    lanes, crossings = all_lanes(hit.prim), BoundaryCrossings(integrand, state.ray)
    hit, way, passes = flown(hit, lanes)
    crossings.add(lanes, hit, state.medium, way.flight.medium, passes)
    lanes = chosen(passes)
    hit, way = apart((hit, way)) if len(lanes) else (hit, way)

    def next_flown(lanes: Tensor) -> Tensor:
        """Follows rays through one more medium; returns the lanes that pass another boundary."""
        ahead, before = pick((way.ahead, way.flight.medium), lanes)
        seen, on, passes = flown(integrand.caster.intersect(ahead), lanes)
        crossings.add(lanes, seen, before, on.flight.medium, passes)
        put_rows((hit, way), lanes, (seen, on))
        return pick(lanes, chosen(passes))

    repeated(lanes, next_flown)
    return hit, way.flight._replace(crossings=crossings.in_turn())


class BoundaryCrossings:
    """Collects the boundaries of media that rays cross, if rays carry derivatives.

    Args:
        integrand: the scene.
        rays: (N,) those that cross.
    """

    def __init__(self, integrand: Integrand, rays: Ray):
        self.kept: list[BoundaryCrossing] | None = [] if integrand.settings.moving else None
        self.part, self.pick, self.rays = integrand.part(Ends.SURROUNDINGS), integrand.stages(rows), rays

    def none(self) -> BoundaryCrossing:
        """The record of a crossing of a medium's boundary in which no ray crosses one."""
        return apart(self.part.call(no_crossing, self.rays.o.x))

    def add(self, lanes: Tensor, hit: Hit, before: Tensor, after: Tensor, passes: Tensor) -> None:
        """Adds a crossing of M rays: their hits, the media on both sides, and whether they pass."""
        crossed = chosen(passes)
        if self.kept is not None and len(crossed):
            self.kept.append(self.none())
            put_rows(self.kept[-1], self.pick(lanes, crossed), self.pick(BoundaryCrossing(hit, before, after), crossed))

    def in_turn(self) -> tuple[BoundaryCrossing, ...] | None:
        """All crossings in order, padded to a power of 2, so that few kinds of functions are compiled; None: rays carry no
        derivatives."""
        if self.kept is None:
            return None
        most = power_of_2(len(self.kept)) if self.kept else 0
        return (*self.kept, *(self.none() for _ in range(most - len(self.kept))))


def free_connections(integrand: Integrand, vertex: Vertex, depth: int) -> tuple[Tensor, ShadowWay | None]:
    """Whether shadow rays of vertices are unoccluded, (N,) bool, and their ways through media; None: rays are not followed.
    Along paths from lamps also False where there is no shadow ray, so that the backward pass leaves out the vertex."""
    return free_ways(integrand, vertex.shadow, vertex.shadow_distance, vertex.shadow_medium, vertex.next.key, depth)


def free_ways(integrand: Integrand, shadow: Ray, distance: Tensor, medium: Tensor | None, key: LaneKey,
              depth: int) -> tuple[Tensor, ShadowWay | None]:
    """Whether straight ways are unoccluded, (N,) bool, and their ways through media; None: rays are not followed.

    Args:
        integrand: the scene.
        shadow, distance: (N,) the ways as rays, and their lengths; 0: none.
        medium: (N,) int32, the media in which they begin; None: rays are not followed.
        key: (N,) of the paths' random numbers.
        depth: of the bounce.
    """
    layout = integrand.proposal.layout
    if not layout.traces_segments:
        hidden = integrand.caster.occluded(shadow, distance)
        return integrand.stages(is_connected)(hidden, distance) if layout.from_lamps else inverted(hidden), None
    part, shadow = integrand.part(Ends.SURROUNDINGS), detached(shadow)
    pick, crossings = integrand.stages(rows), BoundaryCrossings(integrand, shadow)
    passed, begins = part.call(shadow_begun, shadow, distance, medium, key, integrand.at(depth))
    passed = apart(passed)

    def next_passed(lanes: Tensor) -> Tensor:
        """Follows shadow rays to the next surface; returns the lanes that pass it straight."""
        ahead, medium, seed = pick((passed.ahead, passed.medium, passed.seed), lanes)
        met, tracking = integrand.caster.intersect(ahead), None
        if layout.heterogeneous_media:
            length = part.call(shadow_ahead, shadow, distance, passed.ahead, met, lanes)
            tracking = tracking_ended(integrand, ahead, medium, seed, length, length, False, shadow=True)
        on, passes = part.call(next_shadow_segment, shadow, distance, passed, met, tracking, lanes)
        crossings.add(lanes, met, medium, on.medium, passes)
        put_rows(passed, lanes, on)
        return pick(lanes, chosen(passes))

    repeated(chosen(begins), next_passed)
    return passed.free, ShadowWay(passed.ways, passed.medium, passed.panes, crossings.in_turn())


@stage()
def is_connected(hidden: Tensor, distance: Tensor) -> Tensor:
    """(N,) bool: a shadow ray of positive length that is not hidden."""
    return ~hidden & (distance > 0)


def tracking_ended(integrand: Integrand, ahead: Ray, medium: Tensor, seed: Tensor, v: Tensor, length: Tensor,
            flies: bool, shadow: bool = False) -> Tracking:
    """Follows rays through heterogeneous media by delta tracking until they scatter or leave, (N,).

    Args:
        ahead: (N,) rays.
        medium: (N,) int32, numbers of the media.
        seed: (N,) int32, of random numbers.
        v: (N,) the random number that chooses a colour.
        length: (N,) distances to the next surface.
        flies: rays may scatter; else the transmittance of the whole way is estimated.
        shadow: as for `tracking_begun`.
    """
    part, pick = integrand.part(Ends.SURROUNDINGS), integrand.stages(rows)
    tracking = apart(part.call(tracking_begun, ahead, length, medium, seed, shadow))
    for number in integrand.proposal.layout.heterogeneous_media:
        def next_steps(lanes: Tensor, number: int = number) -> Tensor:
            """Takes some tracking steps; returns the lanes that need more."""
            on = part.call(tracking_on, ahead, length, v, tracking, lanes, number, flies)
            put_rows(tracking, lanes, on)
            return pick(lanes, chosen(on.running))

        lanes = chosen(part.call(is_tracked_in, tracking, medium, number))
        if not integrand.kernels_repeat:
            repeated(lanes, next_steps)
        elif len(lanes):
            put_rows(tracking, lanes, part.call(tracking_on, ahead, length, v, tracking, lanes, number, flies))
    return tracking


def apart(record):
    """A copy of a record in which no two fields share memory, to be written into."""
    return mapped(record, lambda leaf: None if leaf is None else duplicated(leaf))


@stage("scene")
def let_through(scene: SceneTensors, light: Vec3, shadow: Ray, length: Tensor, way: ShadowWay) -> Vec3:
    """The light of connections that media and panes let through, (N,), attached.

    Args:
        scene: any part of it.
        light: (N,) without media.
        shadow, length: (N,) the connections as rays, and their lengths.
        way: their ways through media.
    """
    ways = way.ways
    if way.crossings is not None:
        ways = moved_ways(scene, shadow, ways, way.crossings, way.medium, length)
    light = light * transmittance_of(scene, shadow, ways)
    return through_panes(scene, light, shadow, way.panes, way.crossings is not None)
