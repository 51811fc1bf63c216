"""One bounce of path tracing.

With L_k the radiance that leaves vertex k towards vertex k-1,

    L_k = E_k + F_k L_{k+1}

where E_k is what the vertex emits plus the light that reaches it by next-event estimation, and F_k is BSDF times cosine over
the density of the sampled direction (and over the probability of surviving roulette). `bounce` computes E_k, F_k and the
next ray. The image is L_1: `wavefront.py` sums it forwards, with the throughput beta_k = F_1 ... F_{k-1}, and
`adjoint/sweep.py` walks it backwards.

A bounce is computed for lanes that meet surfaces of one appearance, so that none pays for what others meet.

Reference: Li 2020, "Deriving Radiative Backpropagation using the Recursive Form of Path Tracing"; Kajiya 1986.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.path.state import Arrival, PathState, Position, Settings
from torch_radbp.raycast.protocol import Hit
from torch_radbp.sampling.mis import power_heuristic
from torch_radbp.sampling.sampler import (
    CAMERA_COUNTER,
    BounceKey,
    FilmOrder,
    LaneKey,
    SampleKey,
    bounce_key,
    film_lane_key,
    random_bits,
    uniform,
)
from torch_radbp.scene.cone import Cone, camera_cone, cone_beyond
from torch_radbp.scene.interaction import Corners, SurfaceInteraction, surface_interaction
from torch_radbp.scene.light import (
    FAR,
    LightSample,
    emission_places,
    emitted,
    emitted_by_surface,
    emitted_pdf,
    light_aims,
    pdf_of_surface,
    sample_light,
    sample_places,
    shadow_ray,
    vantage,
)
from torch_radbp.scene.light_choice import LightNumbers, LightPick, TreeChoice, chance_of_emitter, drawn_element
from torch_radbp.scene.material import BSDFSample, Material, evaluate, material_at, material_places, sample, sampling_at
from torch_radbp.scene.media import attenuated, transmittance, transmittance_to_light
from torch_radbp.scene.outgoing_ray import outgoing_ray
from torch_radbp.scene.tensors import SceneTensors
from torch_radbp.sensor.kind import Camera
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.stage import stage
from torch_radbp.tensors.vec import Ray, Vec2, Vec3, masked, max_component, rows
from torch_radbp.texture.reader import Place, TextureValue

# The random numbers of one bounce, four coordinates of a point at a time.
BSDF_U, BSDF_V, BSDF_CHOICE, ROULETTE, LIGHT_U, LIGHT_V, LIGHT_CHOICE, LIGHT_SPLIT = range(8)
FILM_U, FILM_V, APERTURE_U, APERTURE_V = range(4)  # those of a camera ray


class CameraSample(NamedTuple):
    """Camera rays with random number keys, (N,)."""

    ray: Ray
    key: LaneKey  # of random numbers
    weight: Tensor | None  # camera weight of their radiance; None: 1
    cone: Cone | None  # ray cone; None if no texture is filtered
    place: Vec2 | None  # position in the pixel, in [0, 1); None: they belong to no pixel


class Scattering(NamedTuple):
    """The terms of L_k = (Le + visible Ld) + F L_{k+1} at one path vertex, and the choices behind them.

    F = sample.weight * thinning.
    """

    Le: Vec3  # emission, weighted against next-event estimation, as the next two after the way through media
    Ld: Vec3  # light by next-event estimation if the shadow ray is free
    si: SurfaceInteraction
    light: LightSample | None  # None without next-event estimation
    material: Material | None  # None where nothing is scattered, as the fields below
    sample: BSDFSample | None  # the direction in which the path goes on
    thinning: Tensor | Vec3 | None  # what F has from media, and from roulette: 1 / survival probability
    survives: Tensor  # bool: the path goes on


class Vertex(NamedTuple):
    """A path vertex as the loop over bounces sees it: its terms, its shadow ray and its continuation."""

    Le: Vec3 | None  # None, as the next two, if radiance is not computed
    Ld: Vec3 | None
    F: Vec3 | None
    shadow: Ray
    shadow_distance: Tensor  # 0: nothing to connect to
    next: PathState  # undefined where the path ends
    survives: Tensor  # bool: the path goes on


@stage("camera")
def sample_camera(camera: Camera, order: FilmOrder, pixel: Tensor, sample: Tensor, key: SampleKey,
                  cones: bool) -> CameraSample:
    """Samples one camera ray per lane.

    Args:
        camera: the sensor.
        order: of the film.
        pixel, sample: (N,) int32, row-major number of the pixel on the film and number of the sample in it.
        key: of the call.
        cones: whether textures ask for them.
    """
    lane = film_lane_key(order, pixel, sample, key)
    camera_key = bounce_key(lane, CAMERA_COUNTER)
    row = torch.div(pixel, order.width, rounding_mode="floor")
    column = pixel - row * order.width
    place = place_in_pixel(camera_key, camera.dtype)
    aperture = None
    if camera.kind.has_aperture:
        aperture = Vec2(*(uniform(camera_key, dimension, camera.dtype) for dimension in (APERTURE_U, APERTURE_V)))
    ray, weight = camera.sample_ray(column, row, place, aperture)
    cone = camera_cone(camera, ray, camera.film.position(column, row, place), aperture) if cones else None
    return CameraSample(ray, lane, weight, cone, place)


@stage()
def film_place(like: Tensor, order: FilmOrder, pixel: Tensor, sample: Tensor, key: SampleKey) -> Vec2:
    """The position of each sample in its pixel, as `sample_camera` draws it; args as there, `like` has the dtype."""
    return place_in_pixel(bounce_key(film_lane_key(order, pixel, sample, key), CAMERA_COUNTER), like.dtype)


def place_in_pixel(key: BounceKey, dtype: torch.dtype) -> Vec2:
    """Random positions in a pixel, (N,) in [0, 1)."""
    return Vec2(*(uniform(key, dimension, dtype) for dimension in (FILM_U, FILM_V)))


@stage("scene", "arrival")
def places(scene: SceneTensors, arrival: Arrival, lanes: Tensor, at: Position, settings: Settings) -> tuple[Place, ...]:
    """The points at which network textures of a bounce are evaluated, see `places_of`; detached. Args as for `bounce`."""
    return places_of(scene, scene, rows(arrival, lanes), at, Settings(nee=settings.nee))


def places_of(scene: SceneTensors, proposal: SceneTensors, arrival: Arrival, at: Position,
              settings: Settings) -> tuple[Place, ...]:
    """The points at which network textures of a bounce are evaluated, attached to the scene, and to the ray if it moves.

    One for each texture of the material that is read outside; for each such reader of emitters' textures one where the ray
    meets the emitter; and, where light is scattered, one at the light sample.
    """
    scatterer, lit = scene.layout.scatterer, scene.layout.lit
    if not lit and (scatterer is None or not scatterer.outside):
        return ()
    si = surface_met(scene, arrival, settings)
    found = () if scatterer is None else material_places(scene, si)
    if lit:
        found += emission_places(scene, si)
    if lit and scatterer is not None and settings.nee:
        numbers = light_numbers(bounce_key(arrival.state.key, at.counter))
        found += sample_places(scene, light_aims(scene, proposal, si.p, numbers, arrival.picked))
    return found


def surface_met(scene: SceneTensors, arrival: Arrival, settings: Settings,
                here: Corners | None = None) -> SurfaceInteraction:
    """The surface interaction of rays; the point slides if the ray's direction is differentiated or not random."""
    slides = None
    if settings.moving:
        slides = torch.isinf(arrival.state.pdf) | (settings.sampling == "attached")
        if settings.following:
            slides = slides | arrival.state.followed
    return surface_interaction(scene, arrival.state.ray, arrival.hit, slides, here, arrival.front, arrival.state.cone)


@stage("scene", "proposal", "arrival")
def ending(scene: SceneTensors, proposal: SceneTensors, arrival: Arrival, lanes: Tensor, at: Position,
           settings: Settings, texture_values: tuple[TextureValue, ...]) -> Vec3:
    """The end of the recursion, L_k = E_k, where nothing is scattered: emission seen by the M paths; attached to `scene`.

    Args as for `bounce`; `scene` is a part where nothing is scattered.
    """
    return scattering(scene, proposal, rows(arrival, lanes), at, settings, texture_values).Le


@stage("scene", "proposal", "arrival")
def bounce(scene: SceneTensors, proposal: SceneTensors, arrival: Arrival, lanes: Tensor, at: Position,
           settings: Settings, texture_values: tuple[TextureValue, ...]) -> Vertex:
    """One step of the recursion L_k = E_k + F_k L_{k+1}: what happens at the vertex, and where the path goes from there.

    Args:
        scene: attached; the part of it that these lanes read, with what scatters there.
        proposal: the same, detached; decides samples, densities, weights and survival.
        arrival: the paths that reach this bounce.
        lanes: (M,) int32, those of them that are computed, in this order.
        at: the depth of this bounce.
        settings: the integrand.
        texture_values: (M,) the values of textures that are read outside.

    Returns:
        The M vertices. `Le`, `Ld` and `F`, and so the throughput, are attached to `scene`, everything else is detached.
    """
    arrival = rows(arrival, lanes)
    state = arrival.state
    local = scattering(scene, proposal, arrival, at, settings, texture_values)

    # Aim the shadow ray at the light sample.
    shadow, distance = state.ray, torch.zeros_like(state.pdf)
    if local.light is not None:
        shadow, distance = shadow_ray(local.si.offset(local.light.d.detach()), local.light)

    # Leave along the sampled direction.
    F = local.sample.weight * local.thinning
    ray = outgoing_ray(local.si, local.sample.wo)
    here = None if state.vantage is None else vantage(local.si)
    terms = (local.Le, local.Ld, F) if settings.shown else (None, None, None)
    return Vertex(*terms, shadow, distance,
                  PathState(ray, state.beta * F, local.sample.pdf, state.key, state.lane, here,
                            followed_by(local.material, state, settings), cone_after(state, local)), local.survives)


def gathered(Le: Vec3, Ld: Vec3, visible: Tensor) -> Vec3:
    """E_k: emission, and the light of next-event estimation where the shadow ray was free."""
    return Le + masked(visible, Ld)


def cone_after(state: PathState, local: Scattering) -> Cone | None:
    """The ray cones of paths that leave a vertex; attached."""
    if state.cone is None:
        return None
    return cone_beyond(state.cone, torch.where(local.si.valid, local.si.t, 0.0), local.sample.pdf)


def followed_by(material: Material, state: PathState, settings: Settings) -> Tensor | None:
    """`PathState.followed` of paths that leave a vertex: hybrid sampling differentiates their direction."""
    return torch.full_like(state.followed, material.kind.follows) if settings.following else None


def scattering(scene: SceneTensors, proposal: SceneTensors, arrival: Arrival, at: Position, settings: Settings,
               texture_values: tuple[TextureValue, ...], here: Corners | None = None) -> Scattering:
    """The vertex without its outgoing ray, one per lane. Args as for `bounce` and `surface_interaction`."""
    # Find the surface that the ray meets.
    state = arrival.state
    si = surface_met(scene, arrival, settings, here)
    of_material, of_met, of_sampled = shares_of(scene, texture_values)

    # Add the light that comes from there, weighted against the chance that next-event estimation finds it.
    zero = torch.zeros_like(state.pdf)
    none = Vec3(zero, zero, zero)
    Le = none
    if not settings.hide_emitters:
        Le = (emitted(scene, state.ray, si, of_met) if scene.layout.scatterer is None
              else emitted_by_surface(scene, si, of_met))
    if settings.nee:
        follows = settings.following and settings.moving
        geometry = scene if settings.sampling == "attached" or follows else proposal
        other = (emitted_pdf(geometry, state.ray, si, proposal, arrival.picked) if scene.layout.scatterer is None
                 else pdf_of_surface(geometry, si, proposal, arrival.picked))
        weight = mis_weight(state.pdf, other, "attached" if follows else settings.sampling)
        Le = Le * (torch.where(state.followed, weight, weight.detach()) if follows else weight)
    through = transmittance(scene, state.ray, torch.where(si.valid, si.t, FAR))
    Le = attenuated(Le, through)
    if scene.layout.scatterer is None:
        return Scattering(Le, none, si, None, None, None, None, torch.zeros_like(si.valid))

    # Look up the material.
    material = material_at(scene, si, of_material)

    # Connect to a point on a light.
    key = bounce_key(state.key, at.counter)
    number = partial(uniform, key, dtype=zero.dtype)
    light, Ld = None, none
    if settings.nee:
        light = sample_light(scene, proposal, si.p, light_numbers(key), arrival.picked, of_sampled)
        light, Ld = next_event(scene, material, si, light, settings)
        Ld = attenuated(Ld, through)

    # Sample the BSDF for the next direction.
    choice = number(BSDF_CHOICE) if material.kind.discrete else None
    chosen = sample(material, si.wi, choice, number(BSDF_U), number(BSDF_V), settings.sampling)

    # Play roulette. The floor keeps black paths alive: a reflectance of zero still has a derivative.
    promise = max_component(attenuated(state.beta * chosen.weight, through).detach())
    survival = torch.minimum(torch.maximum(promise, at.least_survival), at.most_survival)
    survives = si.valid & (chosen.pdf > 0) & (number(ROULETTE) < survival)
    thinning = 1.0 / survival if through is None else through / survival
    return Scattering(Le, Ld, si, light, material, chosen, thinning, survives)


def shares_of(scene: SceneTensors, texture_values: tuple[TextureValue, ...]) -> tuple[tuple[TextureValue, ...], ...]:
    """Splits texture values into those of the material, of emitters that rays hit, and of light samples."""
    of_material = 0 if scene.layout.scatterer is None else len(scene.layout.scatterer.outside)
    met = of_material + len(scene.layout.lit)
    return texture_values[:of_material], texture_values[of_material:met], texture_values[met:]


def light_numbers(key: BounceKey) -> LightNumbers:
    """The random numbers of a bounce's light samples."""
    return LightNumbers(*(random_bits(key, dimension) for dimension in (LIGHT_CHOICE, LIGHT_SPLIT, LIGHT_U, LIGHT_V)))


@stage("scene", "choice")
def pick_light(scene: SceneTensors, choice: TreeChoice, arrival: Arrival, at: Position) -> tuple[Tensor, Tensor]:
    """Selects light elements for next-event estimation by the tree, with their probabilities.

    Args:
        scene: detached; any part of it.
        choice: of the scene.
        arrival: the paths that reach a bounce.
        at: its depth.
    """
    seen = vantage(surface_met(scene, arrival, Settings()))
    return drawn_element(choice, seen, light_numbers(bounce_key(arrival.state.key, at.counter)))


@stage("scene")
def emitter_met(scene: SceneTensors, hit: Hit) -> tuple[Tensor, LightPick]:
    """(N,) bool: rays that hit an emitter, and a `LightPick` without any selection.

    Args:
        scene: detached; any part of it.
        hit: (N,).
    """
    zero = torch.zeros_like(hit.t)
    lit = (hit.prim >= 0) & (lookup(scene.triangles.emitter, hit.prim.clamp_min(0)) >= 0)
    return lit, LightPick(torch.zeros_like(hit.prim), zero, zero)


@stage("scene", "choice", "arrival")
def chance_of_light(scene: SceneTensors, choice: TreeChoice, arrival: Arrival, lanes: Tensor) -> Tensor:
    """The probability of selecting the emitter that each of M paths has hit. Args as for `pick_light` and `bounce`."""
    state, hit = rows((arrival.state, arrival.hit), lanes)
    return chance_of_emitter(choice, state.vantage, lookup(scene.triangles.emitter, hit.prim))


def next_event(scene: SceneTensors, material: Material, si: SurfaceInteraction, light: LightSample,
               settings: Settings) -> tuple[LightSample, Vec3]:
    """The reflected light of a light sample if its shadow ray is free; a sample that cannot connect gets density 0."""
    reflected, pdf = evaluate(material, si.wi, si.frame.to_local(light.d))
    # Where the BSDF is not sampled and not zero the light counts in full; where it is zero but sampled it has derivatives.
    connects = si.valid & (light.pdf > 0) & ((pdf > 0) | (max_component(reflected.detach()) > 0))
    chance, connects = torch.where(connects, light.pdf, 1.0), connects.to(pdf.dtype)
    weighing = chance if light.weighing is light.pdf else torch.where(connects > 0, light.weighing, 1.0)
    weight = mis_weight(weighing, pdf * light.findable, sampling_at(material.kind, settings.sampling))
    Ld = attenuated(reflected * light.radiance * (connects * weight / chance), transmittance_to_light(scene, si.p, light))
    return light._replace(pdf=light.pdf.detach() * connects), Ld


def mis_weight(pdf: Tensor, other: Tensor, sampling: str) -> Tensor:
    """The MIS weight by the power heuristic; attached only if the densities' derivative is needed."""
    weight = power_heuristic(pdf, other)
    return weight if sampling == "attached" else weight.detach()
