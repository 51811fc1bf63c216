"""Reflected light of given light samples: next-event estimation without shadows.

Where scattered directions carry derivatives, and so move unlike the samples, it is weighted against the chance that these
find the light.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.connection.light import light_aims, sample_light, sample_places
from torch_radbp.connection.media import attenuated, transmittance_to_light
from torch_radbp.interface.texture import Place, TextureValue
from torch_radbp.path.event import FlightEnd
from torch_radbp.path.flight import phase_to, point_along, scattered_at_end
from torch_radbp.path.integrand import Integrand
from torch_radbp.path.lanes import put_rows
from torch_radbp.path.light_connection import connected_to_light
from torch_radbp.path.passage import way_through
from torch_radbp.path.sorting import queued
from torch_radbp.path.state import Arrival, Flight, PathState, Settings
from torch_radbp.path.surface import scattered_to, shares_of, surface_met
from torch_radbp.path.texture_networks import texture_values_at
from torch_radbp.raycast.protocol import Hit
from torch_radbp.scene.tables.light_choice import LightNumbers, LightPick
from torch_radbp.scene.tables.scene_tensors import SceneTensors
from torch_radbp.tensors.stage import stage
from torch_radbp.tensors.vec import Vec3, masked, rows
from torch_radbp.vertex.emission import emission_places
from torch_radbp.vertex.material import material_at, material_places, sampling_at


class LightDraw(NamedTuple):
    """The random numbers and selected lights of light samples, (N,)."""

    numbers: LightNumbers
    picked: LightPick


@stage("scene", "arrival", "draw")
def direct_light(scene: SceneTensors, arrival: Arrival, lanes: Tensor, draw: LightDraw,
                 texture_values: tuple[TextureValue, ...], settings: Settings) -> Vec3:
    """Light of one light sample per lane that surfaces reflect back along the rays, without shadows, over its density; (M,).

    Args:
        scene: the part of the scene that the lanes read, detached.
        arrival: the rays and what they meet, (N,).
        lanes: (M,) int32, the rays that are computed.
        draw: (N,) the light samples.
        texture_values: (M,) the values of network textures at the `direct_light_places`.
        settings: of the integrand.
    """
    arrival, draw = rows((arrival, draw), lanes)
    si = surface_met(scene, arrival, Settings())
    of_material, _, of_sampled = shares_of(scene, texture_values)
    material, through = material_at(scene, si, of_material), way_through(scene, arrival, si.t)
    light = sample_light(scene, scene, si.p, draw.numbers, draw.picked, of_sampled)
    if sampling_at(material.kind, settings.sampling) == "attached":
        _, Ld = connected_to_light(scene, si.p, si.valid, partial(scattered_to, material, si), light, "attached")
        return attenuated(Ld, through)
    reflected, _ = scattered_to(material, si, light.d)
    connects = si.valid & (light.pdf > 0)
    Ld = reflected * light.radiance * (connects.to(light.pdf.dtype) / torch.where(connects, light.pdf, 1.0))
    return attenuated(attenuated(Ld, transmittance_to_light(scene, si.p, light)), through)


def direct_light_places(scene: SceneTensors, arrival: Arrival, lanes: Tensor, draw: LightDraw) -> tuple[Place, ...]:
    """The points at which the stage `direct_light` looks up network textures; args as for that."""
    arrival, draw = rows((arrival, draw), lanes)
    si = surface_met(scene, arrival, Settings())
    found = material_places(scene, si)
    if scene.layout.lit:
        found += emission_places(scene, si)
        found += sample_places(scene, light_aims(scene, scene, si.p, draw.numbers, draw.picked))
    return found


def scattered_places(scene: SceneTensors, arrival: Arrival, lanes: Tensor, d: Vec3) -> tuple[Place, ...]:
    """The points at which the stage `scattered` looks up network textures; args as for that."""
    si = surface_met(scene, rows(arrival, lanes), Settings())
    return material_places(scene, si) + emission_places(scene, si)


@stage("scene", "arrival", "d")
def scattered(scene: SceneTensors, arrival: Arrival, lanes: Tensor, d: Vec3,
              texture_values: tuple[TextureValue, ...]) -> Vec3:
    """The BSDF times cosine at the surfaces that rays hit, for light from given directions; (M,).

    Args:
        d: (N,) unit, towards the light; the rest as for `direct_light`.
    """
    arrival, d = rows((arrival, d), lanes)
    si = surface_met(scene, arrival, Settings())
    of_material, *_ = shares_of(scene, texture_values)
    reflected, _ = scattered_to(material_at(scene, si, of_material), si, d)
    return masked(si.valid, attenuated(reflected, way_through(scene, arrival, si.t)))


@stage("scene", "arrival", "d")
def scattered_by_medium(scene: SceneTensors, arrival: Arrival, lanes: Tensor, d: Vec3, texture_values: tuple[()],
                        medium: int) -> Vec3:
    """Scattering coefficient times phase function at points where paths scatter in a medium, for light from `d`; (M,).

    Args:
        texture_values: empty.
        medium: the number of the medium; the rest as for `scattered`.
    """
    arrival, d = rows((arrival, d), lanes)
    ray, t, kind, table = arrival.state.ray, arrival.flight.t, scene.layout.media[medium], scene.media[medium]
    phase, _ = phase_to(kind, table, table, point_along(ray, t), -ray.d, d)
    return scattered_at_end(scene, arrival, medium, t) * phase


@stage("scene", "arrival", "draw")
def direct_light_in_medium(scene: SceneTensors, arrival: Arrival, lanes: Tensor, draw: LightDraw,
                           texture_values: tuple[TextureValue, ...], medium: int) -> Vec3:
    """The light of one light sample per lane that a medium scatters back along the rays, without shadows; (M,). It is
    attenuated on its way from the light where the medium is unbounded.

    Args:
        medium: the number of the medium; the rest as for `direct_light`.
    """
    arrival, draw = rows((arrival, draw), lanes)
    ray, t, kind, table = arrival.state.ray, arrival.flight.t, scene.layout.media[medium], scene.media[medium]
    p = point_along(ray, t)
    light = sample_light(scene, scene, p, draw.numbers, draw.picked, texture_values)
    phase, _ = phase_to(kind, table, table, p, -ray.d, light.d)
    there = (light.pdf > 0).to(light.pdf.dtype) / torch.where(light.pdf > 0, light.pdf, 1.0)
    Ld = scattered_at_end(scene, arrival, medium, t) * phase * light.radiance * there
    return attenuated(Ld, transmittance_to_light(scene, p, light))


def places_in_medium(scene: SceneTensors, arrival: Arrival, lanes: Tensor, draw: LightDraw) -> tuple[Place, ...]:
    """The points at which the stage `direct_light_in_medium` looks up network textures; args as for that."""
    arrival, draw = rows((arrival, draw), lanes)
    if not scene.layout.lit:
        return ()
    p = point_along(arrival.state.ray, arrival.flight.t)
    return sample_places(scene, light_aims(scene, scene, p, draw.numbers, draw.picked))


class VertexQuantity(NamedTuple):
    """A quantity at path vertices: the stages that compute it on surfaces and in media."""

    of_surface: Callable
    places: Callable  # the points at which its network textures are evaluated
    of_medium: Callable
    places_in_medium: Callable


SENT_BACK = VertexQuantity(direct_light, direct_light_places, direct_light_in_medium, places_in_medium)
SCATTERED = VertexQuantity(scattered, scattered_places, scattered_by_medium, lambda *_: ())


def light_sent_back(integrand: Integrand, state: PathState, hit: Hit, draw: LightDraw, flight: Flight | None = None) -> Vec3:
    """The light of one light sample each that is scattered back along all rays, without shadows, (N,): by surfaces, or by
    media where paths scatter before these; 0 where nothing scatters.

    Args:
        integrand: the scene, detached, and how to evaluate it.
        state: (N,) the path states with the rays.
        hit: (N,) what the rays hit.
        draw: the light samples.
        flight: (N,) how far they come in media, where some scatter before `hit`. None: all reach `hit`.
    """
    return of_vertices(integrand, SENT_BACK, Arrival(state, hit, None, flight=flight), draw,
                       Settings(sampling=integrand.settings.sampling))


def scattered_light(integrand: Integrand, state: PathState, hit: Hit, d: Vec3, flight: Flight | None) -> Vec3:
    """BSDF times cosine, or the phase function in media, where rays scatter light from directions `d`, (N,). Args as for
    `light_sent_back`."""
    return of_vertices(integrand, SCATTERED, Arrival(state, hit, None, flight=flight), d)


def of_vertices(integrand: Integrand, quantity: VertexQuantity, arrival: Arrival, given, *more) -> Vec3:
    """Computes a quantity at the vertices that N rays reach, each event by its own stage; 0 where nothing scatters.

    Args:
        quantity: its stages.
        arrival: the rays and what they hit; `front` is found here.
        given: (N,) the light samples or directions that it is computed for.
        more: further arguments of the stage on surfaces.
    """
    state, hit, _, _, flight = arrival
    front, order, queues = queued(integrand, state.ray, hit, False, flight=flight)
    arrival, found = arrival._replace(front=front), Vec3.buffer(state.pdf)
    for queue in queues:
        if not queue.event.scatters:
            continue
        lanes, part = order[queue.first:queue.last], integrand.part(queue.event)
        scatterer, places, inside = integrand.scatterer(queue.event), (), isinstance(queue.event, FlightEnd)
        of_event = (queue.event.medium,) if inside else more
        stage, places_of = quantity[2:] if inside else quantity[:2]
        if part.proposal.layout.lit or scatterer is not None and scatterer.outside:
            places = places_of(part.proposal, arrival, lanes, given)
        values = texture_values_at(integrand.proposal, scatterer, places)
        put_rows(found, lanes, part.call(stage, arrival, lanes, given, values, *of_event))
    return found
