"""The ways of rays through media: where paths scatter before they meet a surface, and what a way leaves of light.

A ray passes boundaries that are surfaces of BSDF `null` straight, from one medium into the next, until it meets a surface
that scatters, or a flight ends in a medium. Passing is no bounce: the hit that is left is that of the last surface, as far
from where the ray began as it is, and the way is told by its lengths in each of the media, which is all that the
transmittance depends on, and its derivative. Connections to lights are followed in the same way.

In each medium the same random number decides anew how far the path flies, of which passing has used up a part.

Reference: Pharr, Jakob and Humphreys 2023, "Physically Based Rendering", section 14.2.2.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.connection.light import FAR
from torch_radbp.connection.media import transmittance, transmittance_of
from torch_radbp.interface.medium import colour_chosen, mean_of_colours
from torch_radbp.path.state import Arrival, Flight, PathState, Position
from torch_radbp.raycast.protocol import Hit
from torch_radbp.sampling.sampler import bounce_key, uniform
from torch_radbp.scene.tables.scene_tensors import SAME, SceneTensors
from torch_radbp.tensors.differentiated import detached, settled
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.stage import stage
from torch_radbp.tensors.vec import TINY, Ray, Vec3, dot, rows
from torch_radbp.vertex.interaction import surface_interaction

SALT = 0x1B873593  # tells the random numbers of flights from those of bounces
FLIGHT_U, FLIGHT_V = range(2)
ALMOST_ONE = 1.0 - 1e-7


class PathPassage(NamedTuple):
    """A ray on its way through media, (N,) each, up to a boundary that it passes."""

    ahead: Ray  # how it goes on from there
    come: Tensor  # distance from where it began
    u: Tensor  # what is left of the random number of distances
    v: Tensor  # the random number that chooses a colour
    beyond: Vec3  # probability of having come so far without scattering, by the colour that is chosen
    flight: Flight  # what is known of it so far


class ShadowPassage(NamedTuple):
    """Shadow rays on their way through media, (N,) each, up to a boundary that they pass."""

    ahead: Ray  # how they go on from there
    come: Tensor  # distance from where they began
    medium: Tensor  # int32, number of that in which they are; -1: none
    free: Tensor  # bool: nothing has blocked them so far
    lengths: tuple[Tensor, ...]  # of the ways in each of `Layout.media`


@stage("scene")
def way_begun(scene: SceneTensors, state: PathState, at: Position) -> PathPassage:
    """The ways of paths before their first leg; args as for `free_flights`."""
    # What decides whether there is a flight at all has a point of its own, beside that of the direction that follows.
    key, ray = bounce_key(state.key, at.counter + SALT), detached(state.ray)
    u, v = (uniform(key, dimension, state.pdf.dtype) for dimension in (FLIGHT_U, FLIGHT_V))
    none = torch.zeros_like(u)
    flight = Flight(none, none, state.medium, (none,) * len(scene.layout.media))
    return PathPassage(ray, none, u, v, Vec3.full(u, 1.0), flight)


@stage("scene", "ray", "way")
def next_leg(scene: SceneTensors, ray: Ray, way: PathPassage, hit: Hit, lanes: Tensor,
             flies: bool) -> tuple[Hit, PathPassage, Tensor]:
    """Takes the next legs of ways: to where paths scatter, to a surface, or through a boundary.

    Args:
        scene: detached; any part of it.
        ray: (N,) as they began.
        way: (N,) so far.
        hit: (M,) what `way.ahead` meets.
        lanes: (M,) int32, those of N that are meant.
        flies: paths may scatter in media; else they go straight to the next surface.

    Returns:
        (M,) hits as seen from where rays began, ways, and whether they go on behind a boundary.
    """
    ray, way = rows((ray, way), lanes)
    si, met, d = surface_interaction(scene, way.ahead, hit), hit.prim >= 0, way.ahead.d
    t = torch.where(met, dot(si.p - ray.o, d), FAR)
    leg = (t - way.come).clamp_min(0.0)
    # Fly through the medium: the distance to where the path scatters, and the probabilities of all that.
    flight, end, density, beyond = way.flight, torch.full_like(leg, torch.inf), Vec3.full(leg, 0.0), Vec3.full(leg, 1.0)
    for number in scene.layout.scattering_media if flies else ():
        kind, table, here = scene.layout.media[number], scene.media[number], flight.medium == number
        distance = kind.sample_flight(table, way.ahead, leg, way.u, way.v)
        of_flight, farther = kind.flight_pdf(table, way.ahead, leg, torch.minimum(distance, leg))
        end = torch.where(here & (distance < leg), distance, end)
        density = Vec3(*(torch.where(here, new, old) for new, old in zip(of_flight, density)))
        beyond = Vec3(*(torch.where(here, new, old) for new, old in zip(farther, beyond)))
    scatters, lasts = end < torch.inf, torch.minimum(end, leg)
    lengths = tuple(length + torch.where(flight.medium == number, lasts, 0.0)
                    for number, length in enumerate(flight.lengths))
    # Go on behind the surface, if it is but a boundary.
    row = lookup(scene.triangles.boundary, si.prim)
    passes = met & ~scatters & lookup(scene.boundaries.invisible, row)
    medium = torch.where(passes, medium_beyond(scene, si.prim, si.cosine, flight.medium), flight.medium)
    used = 1.0 - colour_chosen(beyond, way.v)  # by flights that would have ended before
    u = ((way.u - used) / (1.0 - used).clamp_min(TINY)).clamp(0.0, ALMOST_ONE)
    chance = mean_of_colours(way.beyond * Vec3(*(torch.where(scatters, new, old) for new, old in zip(density, beyond))))
    flight = Flight(torch.where(scatters, way.come + end, torch.inf), chance, medium, lengths)
    way = PathPassage(Ray(si.offset(d), d), t, u, way.v, way.beyond * beyond, flight)
    return hit._replace(t=torch.where(met, t, hit.t)), way, passes


@stage("scene")
def free_flight(scene: SceneTensors, state: PathState, hit: Hit, at: Position) -> Flight:
    """The flights of paths where one medium is around everything.

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


@stage("scene", "shadow", "distance", "passed")
def next_shadow_leg(scene: SceneTensors, shadow: Ray, distance: Tensor, passed: ShadowPassage, hit: Hit,
                    lanes: Tensor) -> tuple[ShadowPassage, Tensor]:
    """Takes the next legs of shadow rays: to the light, or to a surface that blocks it, or through a boundary.

    Args:
        scene: detached; any part of it.
        shadow, distance: (N,) as they began.
        passed: (N,) so far.
        hit: (M,) what `passed.ahead` meets.
        lanes: (M,) int32, those of N that are meant.

    Returns:
        (M,) the same after that, and whether they go on behind a boundary.
    """
    shadow, distance, passed = rows((shadow, distance, passed), lanes)
    si = surface_interaction(scene, passed.ahead, hit)
    t = dot(si.p - shadow.o, shadow.d)
    met = (hit.prim >= 0) & (t < distance)
    end = torch.where(met, t, distance)
    leg = (end - passed.come).clamp_min(0.0)
    lengths = tuple(length + torch.where(passed.medium == number, leg, 0.0) for number, length in enumerate(passed.lengths))
    passes = met & lookup(scene.boundaries.invisible, lookup(scene.triangles.boundary, si.prim))
    medium = torch.where(passes, medium_beyond(scene, si.prim, si.cosine, passed.medium), passed.medium)
    return ShadowPassage(Ray(si.offset(shadow.d), shadow.d), end, medium, ~met, lengths), passes


def medium_beyond(scene: SceneTensors, prim: Tensor, cosine: Tensor, medium: Tensor) -> Tensor:
    """The numbers of the media into which rays leave surfaces, (N,) int32.

    Args:
        scene: detached; any part of it.
        prim: (N,) int32, triangles of the surfaces.
        cosine: (N,) between the geometric normal and the ray.
        medium: (N,) int32, of the rays that came; it is that of all sides of surfaces that bound none.
    """
    row = lookup(scene.triangles.boundary, prim)
    side = torch.where(cosine > 0, lookup(scene.boundaries.outside, row), lookup(scene.boundaries.inside, row))
    return torch.where(side == SAME, medium, side)


def way_left(scene: SceneTensors, arrival: Arrival, distance: Tensor) -> Vec3 | None:
    """The share of light that media let through on the ways of paths, (N,), attached; None: there are no media.

    Args:
        arrival: the paths, with their ways.
        distance: (N,) attached length of the whole way, where no medium has boundaries.
    """
    if scene.layout.bounded:
        return transmittance_of(scene, arrival.state.ray, arrival.flight.lengths)
    return transmittance(scene, arrival.state.ray, distance)


def way_through(scene: SceneTensors, arrival: Arrival, distance: Tensor) -> Vec3 | None:
    """What light that surfaces send along rays counts by, (N,), for paths that have met them; None: there are no media.

    In a medium that scatters only some flights reach the surface, so that those count by transmittance over the probability
    to get there. Args as for `way_left`.
    """
    left = way_left(scene, arrival, distance)
    return left if arrival.flight is None else left / settled(arrival.flight.chance).clamp_min(TINY)
