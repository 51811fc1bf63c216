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
from torch_radbp.connection.media import attenuated, transmittance, transmittance_to_light
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
    """The light of one sample per lane that surfaces reflect along the rays, divided by its density; (M,).

    Args:
        scene: the part that these lanes read, detached.
        arrival: the rays and what they meet, (N,).
        lanes: (M,) int32, those of them that are computed.
        draw: the samples, of all N.
        texture_values: (M,) the values of textures that are read outside, at the `direct_light_places`.
        settings: the integrand's.
    """
    arrival, draw = rows((arrival, draw), lanes)
    si = surface_met(scene, arrival, Settings())
    of_material, _, of_sampled = shares_of(scene, texture_values)
    material, through = material_at(scene, si, of_material), transmittance(scene, arrival.state.ray, si.t)
    light = sample_light(scene, scene, si.p, draw.numbers, draw.picked, of_sampled)
    if sampling_at(material.kind, settings.sampling) == "attached":
        _, Ld = connected_to_light(scene, si.p, si.valid, partial(scattered_to, material, si), light, "attached")
        return attenuated(Ld, through)
    reflected, _ = scattered_to(material, si, light.d)
    connects = si.valid & (light.pdf > 0)
    Ld = reflected * light.radiance * (connects.to(light.pdf.dtype) / torch.where(connects, light.pdf, 1.0))
    return attenuated(attenuated(Ld, transmittance_to_light(scene, si.p, light)), through)


def direct_light_places(scene: SceneTensors, arrival: Arrival, lanes: Tensor, draw: LightDraw) -> tuple[Place, ...]:
    """The points at which `direct_light`'s network textures are evaluated; args as there."""
    arrival, draw = rows((arrival, draw), lanes)
    si = surface_met(scene, arrival, Settings())
    found = material_places(scene, si)
    if scene.layout.lit:
        found += emission_places(scene, si)
        found += sample_places(scene, light_aims(scene, scene, si.p, draw.numbers, draw.picked))
    return found


def scattered_places(scene: SceneTensors, arrival: Arrival, lanes: Tensor, d: Vec3) -> tuple[Place, ...]:
    """The points at which `scattered`'s network textures are evaluated; args as there."""
    si = surface_met(scene, rows(arrival, lanes), Settings())
    return material_places(scene, si) + emission_places(scene, si)


@stage("scene", "arrival", "d")
def scattered(scene: SceneTensors, arrival: Arrival, lanes: Tensor, d: Vec3,
              texture_values: tuple[TextureValue, ...]) -> Vec3:
    """The BSDF times cosine for light from given directions, at the surfaces that rays hit, (M,).

    Args:
        d: (N,) unit, towards the light; the rest as for `direct_light`.
    """
    arrival, d = rows((arrival, d), lanes)
    si = surface_met(scene, arrival, Settings())
    of_material, *_ = shares_of(scene, texture_values)
    reflected, _ = scattered_to(material_at(scene, si, of_material), si, d)
    return masked(si.valid, attenuated(reflected, way_through(scene, arrival, si.t)))


@stage("scene", "arrival", "d")
def scattered_by_medium(scene: SceneTensors, arrival: Arrival, lanes: Tensor, d: Vec3, medium: int) -> Vec3:
    """The same where flights end in a medium: scattering times the phase function.

    Args:
        medium: the number of the medium; the rest as for `scattered`.
    """
    arrival, d = rows((arrival, d), lanes)
    ray, t, kind, table = arrival.state.ray, arrival.flight.t, scene.layout.media[medium], scene.media[medium]
    phase, _ = phase_to(kind, table, table, point_along(ray, t), -ray.d, d)
    return scattered_at_end(scene, arrival, medium, t) * phase


def light_sent_back(integrand: Integrand, state: PathState, hit: Hit, draw: LightDraw) -> Vec3:
    """`direct_light` for all rays, each appearance by its own functions; 0 where nothing scatters.

    Args:
        integrand: of a detached scene.
        state: of the rays, (N,).
        hit: what they meet.
        draw: the light samples.
    """
    return of_surfaces(integrand, direct_light, Arrival(state, hit, None), draw, direct_light_places,
                       Settings(sampling=integrand.settings.sampling))


def scattered_light(integrand: Integrand, state: PathState, hit: Hit, d: Vec3, flight: Flight | None) -> Vec3:
    """`scattered` for all rays, as `light_sent_back`, and `scattered_by_medium` where their flights end before."""
    return of_surfaces(integrand, scattered, Arrival(state, hit, None, flight=flight), d, scattered_places)


def of_surfaces(integrand: Integrand, stage: Callable, arrival: Arrival, asked, places_of: Callable, *more) -> Vec3:
    """Runs a stage for all rays, (N,), each appearance by its own functions; 0 where nothing scatters.

    Args:
        arrival: the rays and what they meet, sides aside.
        asked: of all N.
        places_of: the points at which its network textures are evaluated.
        more: its other arguments.
    """
    state, hit, _, _, flight = arrival
    front, order, queues = queued(integrand, state.ray, hit, False, flight=flight)
    arrival, found = arrival._replace(front=front), Vec3.buffer(state.pdf)
    for queue in queues:
        if not queue.event.scatters:
            continue
        lanes, part = order[queue.first:queue.last], integrand.part(queue.event)
        if isinstance(queue.event, FlightEnd):
            put_rows(found, lanes, part.call(scattered_by_medium, arrival, lanes, asked, queue.event.medium))
            continue
        scatterer, places = integrand.scatterer(queue.event), ()
        if part.proposal.layout.lit or scatterer.outside:
            places = places_of(part.proposal, arrival, lanes, asked)
        values = texture_values_at(integrand.proposal, scatterer, places)
        put_rows(found, lanes, part.call(stage, arrival, lanes, asked, values, *more))
    return found
