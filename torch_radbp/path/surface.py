"""A vertex on a surface: light is emitted, received from a lamp, and scattered by its material."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.connection.light import light_aims, sample_light, sample_places
from torch_radbp.connection.media import attenuated
from torch_radbp.interface.texture import Place, TextureValue
from torch_radbp.path.light_connection import connected_to_light, emission, light_numbers
from torch_radbp.path.light_share import connects, may_go_on
from torch_radbp.path.passage import medium_beyond, shown_through, way_through
from torch_radbp.path.state import BSDF_CHOICE, BSDF_U, BSDF_V, ROULETTE, Arrival, Position, Settings
from torch_radbp.path.vertex import Terms, VertexKind
from torch_radbp.path.volume_emission import with_volume_emission
from torch_radbp.raycast.protocol import Hit
from torch_radbp.sampling.sampler import bounce_key, uniform
from torch_radbp.scene.tables.light_tree import Vantage
from torch_radbp.scene.tables.scene_tensors import SceneTensors
from torch_radbp.scene.tables.triangle_corners import Corners
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.vec import Ray, Vec3, both, dot, max_component
from torch_radbp.vertex.cone import Cone, cone_beyond
from torch_radbp.vertex.emission import emission_places, vantage
from torch_radbp.vertex.interaction import SurfaceInteraction, surface_interaction
from torch_radbp.vertex.material import BSDFSample, Material, evaluate, material_at, material_places, sample, sampling_at
from torch_radbp.vertex.outgoing_ray import above_triangle, attached_outgoing_ray, outgoing_ray


class SurfacePlace(NamedTuple):
    """The surface points of vertices, their materials, and the sampled directions, (N,)."""

    si: SurfaceInteraction
    material: Material
    sample: BSDFSample


@dataclass(frozen=True)
class SurfaceVertex(VertexKind):
    """A path vertex on a surface of one appearance."""

    def places(self, scene: SceneTensors, proposal: SceneTensors, arrival: Arrival, at: Position,
               settings: Settings) -> tuple[Place, ...]:
        lit, outside = scene.layout.lit, scene.layout.scatterer.outside
        if not lit and not outside:
            return ()
        si = surface_met(scene, arrival, settings)
        places = material_places(scene, si)
        if lit:
            places += emission_places(scene, si)
        if lit and settings.nee:
            numbers = light_numbers(bounce_key(arrival.state.key, at.counter))
            places += sample_places(scene, light_aims(scene, proposal, si.p, numbers, arrival.picked))
        return places

    def terms(self, scene: SceneTensors, proposal: SceneTensors, arrival: Arrival, at: Position, settings: Settings,
              texture_values: tuple[TextureValue, ...], here: Corners | None = None) -> Terms:
        # Find the surface that the ray meets, and the share of its light that comes through media.
        state, key = arrival.state, bounce_key(arrival.state.key, at.counter)
        number = partial(uniform, key, dtype=state.pdf.dtype)
        si = surface_met(scene, arrival, settings, here)
        through = way_through(scene, arrival, si.t)
        of_material, of_emitter, of_sample = shares_of(scene, texture_values)

        # Le: the light that it emits, and what media do on the way.
        shown = shown_through(arrival, through)
        Le = attenuated(emission(scene, proposal, arrival, si, settings, of_emitter), shown)
        Le = with_volume_emission(Le, scene, arrival, si.t)

        # Ld: the light of one point on a light, as the material scatters it; ideal lobes scatter none of it.
        material = material_at(scene, si, of_material)
        narrow = None if scene.materials.narrow is None else lookup(scene.materials.narrow, si.material)
        light, Ld = None, Vec3.full(state.pdf, 0.0)
        if settings.nee and material.kind.smooth:
            light = sample_light(scene, proposal, si.p, light_numbers(key), arrival.picked, of_sample)
            may = both(si.valid, connects(settings, scene.layout, state, narrow))
            light, Ld = connected_to_light(scene, si.p, may, partial(scattered_to, material, si), light,
                                  sampling_at(material.kind, settings.sampling))
            Ld = attenuated(Ld, shown)

        if settings.ends:
            none, nobody = torch.zeros_like(state.pdf), torch.zeros_like(si.valid)
            nowhere = BSDFSample(Vec3(*si.wi.map(torch.Tensor.detach)), Vec3(none, none, none), none)
            place = SurfacePlace(si, material, nowhere)
            return Terms(Le, Ld, light, nowhere.weight, none, none, nobody, place, narrow)

        # F: sample the BSDF for the next direction.
        choice = lobe_number(arrival, number(BSDF_CHOICE)) if material.kind.discrete else None
        chosen = sample(material, si.wi, choice, number(BSDF_U), number(BSDF_V), settings.sampling, settings.ideal)
        if material.kind.delta and scene.layout.shading_normals and not scene.layout.from_lamps:
            chosen = above_triangle(scene, si, arrival.hit, chosen)

        # Play roulette. The floor keeps black paths alive: a reflectance of zero still has a derivative.
        promise = max_component(attenuated(state.beta * chosen.weight, through).detach())
        survival = torch.minimum(torch.maximum(promise, at.least_survival), at.most_survival)
        survives = si.valid & (chosen.pdf > 0) & (number(ROULETTE) < survival)
        survives = both(survives, may_go_on(settings, scene.layout, state, chosen.pdf, narrow))
        thinning = 1.0 / survival if through is None else through / survival
        place = SurfacePlace(si, material, chosen)
        return Terms(Le, Ld, light, chosen.weight, thinning, chosen.pdf, survives, place, narrow)

    def origin(self, terms: Terms, d: Vec3) -> Vec3:
        return terms.place.si.offset(d)

    def vantage(self, terms: Terms) -> Vantage:
        return vantage(terms.place.si)

    def medium(self, scene: SceneTensors, terms: Terms, arrival: Arrival, d: Vec3) -> Tensor:
        si = terms.place.si
        return medium_beyond(scene, si.prim, dot(si.n, d), arrival.flight.medium)

    def ray(self, terms: Terms) -> Ray:
        return outgoing_ray(terms.place.si, terms.place.sample.wo)

    def attached_ray(self, scene: SceneTensors, terms: Terms, following: Hit, sampling: str,
                     there: Corners | None = None) -> tuple[Vec3, Ray]:
        si, material, chosen = terms.place
        return attached_outgoing_ray(scene, material, si, chosen, following, sampling, there)

    def cone(self, terms: Terms, cone: Cone) -> Cone:
        si = terms.place.si
        return cone_beyond(cone, torch.where(si.valid, si.t, 0.0), terms.pdf)

    def follows(self, terms: Terms) -> bool:
        return terms.place.material.kind.follows


SURFACE = SurfaceVertex()


def surface_met(scene: SceneTensors, arrival: Arrival, settings: Settings,
                here: Corners | None = None) -> SurfaceInteraction:
    """The surface interactions of rays; points move with rays that are differentiated or not random, else with triangles."""
    slides = None
    if settings.moving:
        pdf = arrival.state.pdf
        slides = pdf > 0 if settings.sampling == "attached" else torch.isinf(pdf)
        if settings.following:
            slides = slides | arrival.state.followed
    return surface_interaction(scene, arrival.state.ray, arrival.hit, slides, here, arrival.front, arrival.state.cone)


def scattered_to(material: Material, si: SurfaceInteraction, d: Vec3) -> tuple[Vec3, Tensor]:
    """The BSDF times cosine for light from world direction `d`, and the solid-angle density of sampling `d`."""
    return evaluate(material, si.wi, si.frame.to_local(d))


def lobe_number(arrival: Arrival, number: Tensor) -> Tensor:
    """The random number that selects a BSDF lobe, (N,): the one that chose to hit instead of pass the surface, or
    `number`."""
    return number if arrival.flight is None or arrival.flight.choice is None else arrival.flight.choice


def shares_of(scene: SceneTensors, texture_values: tuple[TextureValue, ...]) -> tuple[tuple[TextureValue, ...], ...]:
    """Splits network texture values into those of the material, of hit emitters, and of light samples."""
    of_material = len(scene.layout.scatterer.outside)
    met = of_material + len(scene.layout.lit)
    return texture_values[:of_material], texture_values[of_material:met], texture_values[met:]
