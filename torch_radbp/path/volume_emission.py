"""What media emit along the rays of paths.

A ray of length l that ends on a surface, or nowhere, brings

    int_0^l T(t) e(t) dt

with T the transmittance up to a distance t and e the radiance that is emitted there per unit of length. That is estimated at
one place of each ray: on each segment one is sampled, and one of the segments is picked, by what light of even emission
would bring from there (a reservoir). Nothing is divided by the extinction or by the emission, so that both may be 0, and
have the right derivatives there. Segments that only some flights reach count by the probability of that, and by what the
panes before them let through.

Reference: Chandrasekhar 1960, "Radiative Transfer"; Pharr, Jakob and Humphreys 2023, "Physically Based Rendering", section
14.1.2.
"""

from __future__ import annotations

import torch
from torch import Tensor

from torch_radbp.connection.media import transmittance_of
from torch_radbp.interface.medium import Tracking, mean_of_colours
from torch_radbp.path.panes import no_panes, through_panes
from torch_radbp.path.passage import (
    PathPassage,
    Segment,
    distance_passed,
    moved_ways,
    segment_around,
    segment_inside,
    surface_ahead,
    ways_at_first,
    with_segment,
)
from torch_radbp.path.state import Arrival, EmissionPlace, PathState
from torch_radbp.raycast.protocol import Hit
from torch_radbp.sampling.sampler import next_number
from torch_radbp.scene.tables.scene_tensors import SceneTensors
from torch_radbp.tensors.differentiated import settled
from torch_radbp.tensors.record import selected
from torch_radbp.tensors.stage import stage
from torch_radbp.tensors.vec import TINY, Ray, Vec3, dot, rows, where

SALT = 0x3C6EF372  # tells the random numbers of places from those of flights


@stage("scene")
def emission_begun(scene: SceneTensors, state: PathState) -> EmissionPlace:
    """The points on path segments at which media's emission is evaluated, (N,), before any is sampled.

    Args:
        scene: detached; any part of it.
        state: the paths.
    """
    none = torch.zeros_like(state.pdf)
    ways, nowhere = ways_at_first(scene, none), torch.full_like(state.lane, -1)
    return EmissionPlace(none, nowhere, none, none, ways, no_panes(scene, none))


@stage("scene", "ray", "way")
def emission_on_segment(scene: SceneTensors, ray: Ray, way: PathPassage, hit: Hit, tracking: Tracking | None,
                    lanes: Tensor) -> EmissionPlace:
    """The sampled emission points of rays after one more segment, (M,); args as for `passage.next_segment`."""
    length, (ray, way) = surface_ahead(scene, way.ahead, way.flight.medium, hit, lanes), rows((ray, way), lanes)
    flight, come, before = way.flight, dot(way.ahead.o - ray.o, way.ahead.d), way.flight.emission
    assert before is not None
    seed, u = next_number(way.seed + SALT, length.dtype)
    # Where on the segment, and how densely does the colour that decides fly through there?
    place, density, emits = torch.zeros_like(length), Vec3.full(length, 1.0), torch.zeros_like(length, dtype=torch.bool)
    for number in scene.layout.emitting_media:
        kind, table, here = scene.layout.media[number], scene.media[number], flight.medium == number
        if kind.heterogeneous:
            first, last = kind.enter(table, way.ahead, length)
            flown, t = torch.minimum(last, tracking.end) - first, tracking.emission.t
            of_colours, here = tracking.emission.beyond / flown.clamp_min(TINY), here & (flown > 0)
        else:
            t, of_colours = kind.sample_emission(table, way.ahead, length, u, way.v)
        place, density, emits = torch.where(here, t, place), where(here, of_colours, density), emits | here
    weight = 1.0 / mean_of_colours(way.beyond * density).clamp_min(TINY)
    # What is left of light on the way from there; whatever it is, it is estimated without bias.
    if tracking is not None and tracking.emission is not None:
        tracking = tracking._replace(left=tracking.emission.left)
    ways = with_segment(scene, flight.ways, flight.medium, Segment(way.ahead, come, length, place, tracking))
    worth = torch.where(emits, weight * mean_of_colours(transmittance_of(scene, ray, ways)), 0.0)
    # Pick this segment, or one before.
    total = before.total + worth
    _, u = next_number(seed, length.dtype)
    here = u * total < worth
    share = torch.where(here, weight / worth.clamp_min(TINY), before.weight / before.total.clamp_min(TINY))
    picked = selected(here, EmissionPlace(come + place, flight.medium, weight, total, ways, flight.panes), before)
    return picked._replace(weight=share * total, total=total)


def with_volume_emission(Le: Vec3, scene: SceneTensors, arrival: Arrival, distance: Tensor) -> Vec3:
    """The emission of vertices plus that of the media before them, (N,), attached.

    Args:
        Le: (N,) of the vertices alone.
        scene: any part of it.
        arrival: the paths, with their ways through media.
        distance: (N,) to the surfaces that rays meet, attached; 1e10 where they meet none.
    """
    if arrival.flight is None or arrival.flight.emission is None:
        return Le
    ray, crossings = arrival.state.ray, arrival.flight.crossings
    t, medium, weight, _, ways, panes = arrival.flight.emission
    if crossings is not None:
        # The place stays where it is on its segment, as a share of that, and counts by how much longer the segment is.
        begins, ends = segment_around(t, [distance_passed(scene, ray, crossing.hit) for crossing in crossings], distance)
        first, segment = begins, ends - begins
        for number in scene.layout.emitting_media:
            kind = scene.layout.media[number]
            if kind.heterogeneous:
                inside = segment_inside(kind, scene.media[number], ray, begins, ends)
                first, segment = selected(medium == number, inside, (first, segment))
        longer = segment / settled(segment).clamp_min(TINY)
        passed = tuple(crossing._replace(hit=crossing.hit._replace(
            prim=torch.where(crossing.hit.t < t, crossing.hit.prim, -1))) for crossing in crossings)
        t, weight = first + (t - settled(first)) * longer, weight * longer
        ways = moved_ways(scene, ray, ways, passed, medium, t)
    emitted = Vec3.full(t, 0.0)
    for number in scene.layout.emitting_media:
        light = scene.layout.media[number].emitted(scene.media[number], ray.o + ray.d * t)
        emitted = where(medium == number, light, emitted)
    left = through_panes(scene, transmittance_of(scene, ray, ways), ray, panes, crossings is not None)
    return Le + left * emitted * weight
