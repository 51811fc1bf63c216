"""A vertex in a medium that scatters: the flight of a path ends there before it meets a surface.

With T(t) the transmittance over a distance t, sigma_s what is scattered per unit of length, and p(t) the density of flights
that end at t,

    F = T(t) sigma_s / p(t) * phase / density,    E = T(t) sigma_s / p(t) * Ld

with Ld the light of one sample that the phase function scatters. A flight that ends keeps its distance, as a share of the
way to the surface where that moves; so flights fill the way at every time, and its length changes their density.

Reference: Chandrasekhar 1960, "Radiative Transfer"; Pharr, Jakob and Humphreys 2023, "Physically Based Rendering",
chapter 14.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torch_radbp.connection.light import FAR, light_aims, sample_light, sample_places
from torch_radbp.interface.medium import MediumKind
from torch_radbp.interface.texture import Place, TextureValue
from torch_radbp.path.light_connection import connected_to_light, light_numbers
from torch_radbp.path.light_share import connects, may_go_on
from torch_radbp.path.passage import distance_passed, segment_inside, way_left
from torch_radbp.path.state import BSDF_U, BSDF_V, ROULETTE, Arrival, Position, Settings
from torch_radbp.path.surface import surface_met
from torch_radbp.path.vertex import Terms, VertexKind
from torch_radbp.path.volume_emission import with_volume_emission
from torch_radbp.raycast.protocol import Hit
from torch_radbp.sampling.sampler import bounce_key, uniform
from torch_radbp.scene.tables.light_tree import Vantage
from torch_radbp.scene.tables.placement import points_in_world
from torch_radbp.scene.tables.scene_tensors import SceneTensors
from torch_radbp.scene.tables.triangle_corners import Corners, at_corners
from torch_radbp.tensors.differentiated import settled
from torch_radbp.tensors.vec import TINY, Ray, Vec3, both, max_component
from torch_radbp.vertex.cone import Cone, cone_beyond
from torch_radbp.vertex.interaction import corner_rows, is_met
from torch_radbp.vertex.nearby import Floor
from torch_radbp.vertex.outgoing_ray import glued_direction, slide_of


class FlightPlace(NamedTuple):
    """The points at which paths scatter in a medium, and the directions before and after, (N,)."""

    kind: MediumKind
    table: Any  # attached
    p: Vec3  # attached
    t: Tensor  # distance that the ray has come, attached
    wi: Vec3  # towards where the path comes from
    wo: Vec3  # in which it goes on


@dataclass(frozen=True)
class FlightVertex(VertexKind):
    """A path vertex inside of a medium, given by its number in `Layout.media`."""

    number: int

    def places(self, scene: SceneTensors, proposal: SceneTensors, arrival: Arrival, at: Position,
               settings: Settings) -> tuple[Place, ...]:
        if not scene.layout.lit or not settings.nee:
            return ()
        t, _ = self.distance_flown(scene, arrival, settings)
        p, numbers = point_along(arrival.state.ray, t), light_numbers(bounce_key(arrival.state.key, at.counter))
        return sample_places(scene, light_aims(scene, proposal, p, numbers, arrival.picked))

    def terms(self, scene: SceneTensors, proposal: SceneTensors, arrival: Arrival, at: Position, settings: Settings,
              texture_values: tuple[TextureValue, ...], here: Corners | None = None) -> Terms:
        # Fly to the end, and find what is scattered there of the light that comes back: T sigma_s / p.
        state, key = arrival.state, bounce_key(arrival.state.key, at.counter)
        number, medium = partial(uniform, key, dtype=state.pdf.dtype), self.number
        kind, table, fixed = scene.layout.media[medium], scene.media[medium], proposal.media[medium]
        t, longer = self.distance_flown(scene, arrival, settings, here)
        p, wi = point_along(state.ray, t), -state.ray.d
        scattered = scattered_at_end(scene, arrival, medium, t) * longer

        # Le: the light that media emit on the way, up to the next surface.
        surface = t
        if settings.moving and arrival.flight.emission is not None:
            si = surface_met(scene, arrival, settings, here)
            surface = torch.where(si.valid, si.t, FAR)
        Le = with_volume_emission(Vec3.full(t, 0.0), scene, arrival, surface)

        # Ld: the light of one point on a light, as the phase function scatters it.
        none, there = Vec3.full(state.pdf, 0.0), torch.ones_like(state.pdf, dtype=torch.bool)
        light, Ld = None, none
        if settings.nee:
            light = sample_light(scene, proposal, p, light_numbers(key), arrival.picked, texture_values)
            scatters_to = partial(phase_to, kind, table, fixed, p, wi)
            there = both(there, connects(settings, scene.layout, state, None))
            light, Ld = connected_to_light(scene, p, there, scatters_to, light, settings.sampling)
            Ld = Ld * scattered

        # F: sample the phase function for the next direction, which stays where it is.
        wo = kind.sample_phase(fixed, p, wi, number(BSDF_U), number(BSDF_V)).map(settled)
        phase, pdf = phase_to(kind, table, fixed, p, wi, wo)
        weight = scattered * (phase.x / settled(pdf))
        pdf = pdf if settings.sampling == "attached" else pdf.detach()

        # Play roulette.
        promise = max_component((state.beta * weight).detach())
        survival = torch.minimum(torch.maximum(promise, at.least_survival), at.most_survival)
        goes_on = number(ROULETTE) < (torch.zeros_like(survival) if settings.ends else survival)
        survives = both(goes_on, may_go_on(settings, scene.layout, state, pdf, None))
        place = FlightPlace(kind, table, p, t, wi, wo)
        return Terms(Le, Ld, light, weight, 1.0 / survival, pdf, survives, place)

    def distance_flown(self, scene: SceneTensors, arrival: Arrival, settings: Settings,
                       here: Corners | None = None) -> tuple[Tensor, Tensor | float]:
        """The distances from ray origins to the scattering points, (N,), and how the length of the way through the medium
        changes, as a factor of value 1; both attached if geometry or rays move. Args as for `VertexKind.terms`."""
        flight, ray = arrival.flight, arrival.state.ray
        if not settings.moving:
            return flight.t, 1.0
        # From the last boundary that was passed to the next surface, of which the flight has come a share.
        si, begins = surface_met(scene, arrival, settings, here), torch.zeros_like(flight.t)
        for crossing in flight.crossings or ():
            passed = distance_passed(scene, ray, crossing.hit)
            begins = torch.where(settled(passed) < torch.inf, passed, begins)
        kind = scene.layout.media[self.number]
        if kind.heterogeneous:
            begins, way = segment_inside(kind, scene.media[self.number], ray, begins, torch.where(si.valid, si.t, FAR))
        else:
            way = torch.where(si.valid, si.t - begins, 1.0)
        longer = way / settled(way)
        return begins + (flight.t - settled(begins)) * longer, longer

    def origin(self, terms: Terms, d: Vec3) -> Vec3:
        return terms.place.p

    def vantage(self, terms: Terms) -> Vantage:
        return Vantage(terms.place.p.map(settled), Vec3.full(terms.place.t, 0.0))

    def medium(self, scene: SceneTensors, terms: Terms, arrival: Arrival, d: Vec3) -> Tensor:
        return arrival.flight.medium

    def ray(self, terms: Terms) -> Ray:
        return Ray(terms.place.p, terms.place.wo)

    def attached_ray(self, scene: SceneTensors, terms: Terms, following: Hit, sampling: str,
                     there: Corners | None = None) -> tuple[Vec3, Ray]:
        kind, table, p, _, wi, wo = terms.place
        if sampling == "attached":
            return terms.weight, Ray(p, wo)
        # The direction follows the point of the surface that the ray would meet, as from a surface; close to it less so.
        if there is None:
            there = at_corners(scene.triangles.vertices.p, corner_rows(scene, following))
        there = points_in_world(scene, following, there)
        slide = slide_of(scene, floor_in_medium(scene, p), there, wo, following)
        d, change = glued_direction(there, p, wo, following, is_met(scene, following), slide)
        phase, _ = kind.phase(table, p, wi, d)
        fixed, _ = kind.phase(table, p, wi, wo)
        return terms.weight * (change * (1.0 + (phase - fixed) / fixed.detach())), Ray(p, d)

    def cone(self, terms: Terms, cone: Cone) -> Cone:
        return cone_beyond(cone, terms.place.t, terms.pdf)


def point_along(ray: Ray, t: Tensor) -> Vec3:
    """The points at distances `t` along rays, (N,)."""
    return ray.o + ray.d * t


def floor_in_medium(scene: SceneTensors, p: Vec3) -> Floor | None:
    """The surface on which vertices p stand, here none, since they are in a medium, for the sliding of points near them.

    None: no material lets points slide.
    """
    none = torch.zeros_like(p.x)
    return None if scene.triangles.plain is None else Floor(p.map(settled), Vec3(none, none, none), none > 0, none)


def scattered_at_end(scene: SceneTensors, arrival: Arrival, medium: int, t: Tensor) -> Vec3:
    """The factor T sigma_s / p of light that is scattered at the end of flights, (N,), attached; the phase function aside.

    Args:
        arrival: the paths, with their flights.
        medium: the number of the medium in which they scatter.
        t: (N,) distance to the scattering point, attached.
    """
    kind, table, ray = scene.layout.media[medium], scene.media[medium], arrival.state.ray
    scattering = kind.scattering(table, point_along(ray, t), -ray.d)
    return way_left(scene, arrival, t) * scattering / settled(arrival.flight.chance).clamp_min(TINY)


def phase_to(kind: MediumKind, table: Any, fixed: Any, p: Vec3, wi: Vec3, d: Vec3) -> tuple[Vec3, Tensor]:
    """The phase function for light from world direction `d`, and the solid-angle density of sampling `d`.

    Args:
        kind, table: the medium, attached.
        fixed: the same table, detached, by which directions are sampled.
        p, wi, d: as for `MediumKind.phase`.
    """
    (phase, _), (_, pdf) = kind.phase(table, p, wi, d), kind.phase(fixed, p, wi, d)
    return Vec3(phase, phase, phase), pdf


def flight_vantage(arrival: Arrival) -> Vantage:
    """The scattering points in media as reference points for light selection: without a normal, lit from all around."""
    t = arrival.flight.t
    p = point_along(arrival.state.ray, torch.where(t < torch.inf, t, 0.0))
    return Vantage(p.map(settled), Vec3.full(t, 0.0))
