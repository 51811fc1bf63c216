"""One bounce of path tracing, and the loop over bounces.

With L_k the radiance that leaves vertex k towards vertex k-1,

    L_k = E_k + F_k L_{k+1}

where E_k is what the vertex emits plus the light that reaches it by next-event estimation, and F_k is BSDF times cosine over
the density of the sampled direction (and over the probability of surviving roulette). `bounce` computes E_k, F_k and the
next ray; the image is L_1, summed forwards here with the throughput beta_k = F_1 ... F_{k-1}, and walked backwards by
`adjoint/sweep.py`.

Reference: Li 2020, "Deriving Radiative Backpropagation using the Recursive Form of Path Tracing"; Kajiya 1986.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.raycast.protocol import Hit, RayCaster
from torch_radbp.sampling.mis import power_heuristic
from torch_radbp.sampling.sampler import (
    CAMERA_COUNTER,
    LaneKey,
    SampleKey,
    bounce_key,
    depth_counter,
    lane_key,
    random_bits,
    uniform,
)
from torch_radbp.scene.camera_hit import camera_hit
from torch_radbp.scene.departure import departure
from torch_radbp.scene.interaction import Corners, SurfaceInteraction, surface_interaction
from torch_radbp.scene.light import LightNumbers, LightSample, emitted, emitted_pdf, sample_light, shadow_ray
from torch_radbp.scene.material import BSDFSample, Material, evaluate, material_at, sample
from torch_radbp.scene.tensors import SceneTensors
from torch_radbp.sensor.perspective import PinholeTensors, camera_ray
from torch_radbp.vec import Ray, Vec3, masked, max_component, rows

# The random numbers of one bounce, four coordinates of a point at a time.
BSDF_U, BSDF_V, BSDF_CHOICE, ROULETTE, LIGHT_U, LIGHT_V, LIGHT_CHOICE, LIGHT_SPLIT = range(8)

SURVIVE_AT_LEAST, SURVIVE_AT_MOST = 0.05, 0.95


class Settings(NamedTuple):
    """The static settings of the integrand, compiled in."""

    nee: bool = True
    hide_emitters: bool = False  # at this bounce
    last: bool = False  # the path ends here: only emission counts
    moving: bool = False  # rays carry derivatives
    sampling: str = "detached"  # if they do, which go through the choice of directions: "detached", "hybrid", "attached"


class Position(NamedTuple):
    """The place of a bounce on its path: () tensors, so that one compiled function serves every bounce."""

    counter: Tensor  # int32, of the random numbers of this depth
    least_survival: Tensor  # bounds of the probability of surviving roulette; both 1 before `rr_depth`
    most_survival: Tensor


class PathState(NamedTuple):
    """All that a bounce needs to know of the path so far, per lane; what a schedule keeps."""

    ray: Ray
    beta: Vec3  # throughput
    pdf: Tensor  # density over solid angle of the ray's direction; infinite: not left to chance
    key: LaneKey  # of the lane's random numbers
    lane: Tensor  # int32, the lane's place in its chunk; dead lanes leave, so that places have gaps


class Step(NamedTuple):
    """The decisions of a bounce: those that would cost rays to repeat, and whether the path goes on.

    Whoever takes the bounce again goes by this record, so that all agree even where rounding would decide otherwise (of
    another device, another number of threads, a compiled function and an eager one).
    """

    hit: Hit
    visible: Tensor  # bool: the shadow ray was free
    survives: Tensor  # bool: the path goes on


class Scattering(NamedTuple):
    """The terms of L_k = (Le + visible Ld) + F L_{k+1} at one path vertex, and the choices behind them.

    F = sample.weight * thinning.
    """

    Le: Vec3  # emission, weighted against next-event estimation
    Ld: Vec3  # light by next-event estimation if the shadow ray is free
    si: SurfaceInteraction
    light: LightSample | None  # None without next-event estimation
    material: Material | None  # None at the last vertex, as what follows
    sample: BSDFSample | None  # the direction in which the path goes on
    thinning: Tensor | None  # what F has from roulette: 1 / survival probability
    survives: Tensor  # bool: the path goes on


class Vertex(NamedTuple):
    """A path vertex as the loop over bounces sees it: its terms, its shadow ray and its continuation."""

    Le: Vec3
    Ld: Vec3
    F: Vec3
    shadow: Ray
    shadow_distance: Tensor  # 0: nothing to connect to
    next: PathState  # of no meaning where the path ends
    survives: Tensor  # bool: the path goes on


def sample_camera(camera: PinholeTensors, width: Tensor, pixel: Tensor, sample: Tensor,
                  key: SampleKey) -> tuple[Ray, LaneKey]:
    """One camera ray per lane, and the lane's key of random numbers.

    Args:
        camera: the sensor.
        width: () int32, of the crop window, pixels.
        pixel, sample: (N,) int32, row-major pixel of the crop window and number of the sample in it.
        key: of the call.
    """
    lane = lane_key(key, pixel, sample)
    camera_key = bounce_key(lane, CAMERA_COUNTER)
    dtype = camera.tan_x.dtype
    row = torch.div(pixel, width, rounding_mode="floor")
    column = pixel - row * width
    return camera_ray(camera, column, row, uniform(camera_key, 0, dtype), uniform(camera_key, 1, dtype)), lane


def start_path(ray: Ray, key: LaneKey) -> PathState:
    """The state before the first bounce: throughput 1, every lane in its place."""
    beta = Vec3(torch.ones_like(ray.d.x), torch.ones_like(ray.d.x), torch.ones_like(ray.d.x))
    lane = torch.arange(len(ray.d.x), dtype=torch.int32, device=ray.d.x.device)
    return PathState(ray, beta, torch.full_like(ray.d.x, torch.inf), key, lane)


def bounce(scene: SceneTensors, proposal: SceneTensors, state: PathState, hit: Hit, at: Position,
           settings: Settings) -> Vertex:
    """One step of the recursion L_k = E_k + F_k L_{k+1}: what happens at the vertex, and where the path goes from there.

    Args:
        scene: attached; what is integrated.
        proposal: detached; decides samples, densities, weights and survival.
        state: the path so far.
        hit: what the ray meets.
        at: the depth of this bounce.
        settings: the integrand.

    Returns:
        The vertex. `Le`, `Ld` and `F`, and so the throughput, are attached to `scene`, everything else is detached.
    """
    local = scattering(scene, proposal, state, hit, at, settings)

    # Aim the shadow ray at the light sample.
    zero = torch.zeros_like(state.pdf)
    shadow, distance = (state.ray, zero) if local.light is None else shadow_ray(local.si, local.light)

    # Leave along the sampled direction.
    if local.sample is None:
        return Vertex(local.Le, local.Ld, Vec3(zero, zero, zero), shadow, distance, state, local.survives)
    F = local.sample.weight * local.thinning
    ray = departure(local.si, local.sample.wo)
    return Vertex(local.Le, local.Ld, F, shadow, distance,
                  PathState(ray, state.beta * F, local.sample.pdf, state.key, state.lane), local.survives)


def scattering(scene: SceneTensors, proposal: SceneTensors, state: PathState, hit: Hit, at: Position,
               settings: Settings, here: Corners | None = None) -> Scattering:
    """The vertex without its outgoing ray. Args as for `bounce` and `surface_interaction`; attached to them."""
    # Find the surface that the ray meets. The point slides where the ray was not left to chance, or is followed.
    slides = None
    if settings.moving:
        slides = torch.isinf(state.pdf) | (settings.sampling == "attached")
    si = surface_interaction(scene, state.ray, hit, slides, here)

    # Add the light that it emits, weighted against the chance that next-event estimation finds it.
    zero = torch.zeros_like(state.pdf)
    none = Vec3(zero, zero, zero)
    Le = none if settings.hide_emitters else emitted(scene, state.ray, si)
    if settings.nee:
        geometry = scene if settings.sampling == "attached" else proposal
        Le = Le * mis_weight(state.pdf, emitted_pdf(geometry, state.ray, si, proposal), settings)
    if settings.last:
        return Scattering(Le, none, si, None, None, None, None, torch.zeros_like(si.valid))

    # Look up the material.
    material = material_at(scene, si)

    # Connect to a point on a light.
    key = bounce_key(state.key, at.counter)
    number = partial(uniform, key, dtype=zero.dtype)
    light, Ld = None, none
    if settings.nee:
        numbers = LightNumbers(*(random_bits(key, dimension) for dimension in (LIGHT_CHOICE, LIGHT_SPLIT, LIGHT_U, LIGHT_V)))
        light = sample_light(scene, proposal, si, numbers)
        light, Ld = next_event(material, si, light, settings)

    # Sample the BSDF for the next direction.
    choice = number(BSDF_CHOICE) if material.discrete else None
    chosen = sample(material, si.wi, choice, number(BSDF_U), number(BSDF_V), settings.sampling)

    # Play roulette. The floor keeps black paths alive: a reflectance of zero still has a derivative.
    promise = max_component((state.beta * chosen.weight).detach())
    survival = torch.minimum(torch.maximum(promise, at.least_survival), at.most_survival)
    survives = si.valid & (chosen.pdf > 0) & (number(ROULETTE) < survival)
    return Scattering(Le, Ld, si, light, material, chosen, 1.0 / survival, survives)


def next_event(material: Material, si: SurfaceInteraction, light: LightSample,
               settings: Settings) -> tuple[LightSample, Vec3]:
    """The light that arrives from a light sample if nothing is in between; a sample that cannot connect gets density 0."""
    reflected, pdf = evaluate(material, si.wi, si.frame.to_local(light.d))
    # Where the BSDF is not sampled and not zero the light counts in full; where it is zero but sampled it has derivatives.
    connects = si.valid & (light.pdf > 0) & ((pdf > 0) | (max_component(reflected.detach()) > 0))
    chance, connects = torch.where(connects, light.pdf, 1.0), connects.to(pdf.dtype)
    weighing = chance if light.weighing is light.pdf else torch.where(connects > 0, light.weighing, 1.0)
    weight = mis_weight(weighing, pdf * light.findable, settings)
    Ld = reflected * light.radiance * (connects * weight / chance)
    return light._replace(pdf=light.pdf.detach() * connects), Ld


def mis_weight(pdf: Tensor, other: Tensor, settings: Settings) -> Tensor:
    """The power heuristic; it carries a derivative only if that of the densities is wanted."""
    weight = power_heuristic(pdf, other)
    return weight if settings.sampling == "attached" else weight.detach()


class Integrand(NamedTuple):
    """The integrand with the functions that evaluate it: everything about a rendering but its lanes."""

    scene: SceneTensors  # attached if plain autograd is to record the loop
    proposal: SceneTensors  # the same, detached
    caster: RayCaster
    settings: Settings
    max_depth: int
    rr_depth: int
    bounce: Callable[..., Vertex]  # `bounce`, eager or compiled
    clipping: PinholeTensors | None = None  # the camera of the paths, if its far plane cuts the scene

    def at(self, depth: int) -> Position:
        """The position on the path as tensors."""
        like = self.scene.lights.choice.pmf
        roulette = depth + 1 >= self.rr_depth
        return Position(depth_counter(depth, like.device),
                        like.new_tensor(SURVIVE_AT_LEAST if roulette else 1.0),
                        like.new_tensor(SURVIVE_AT_MOST if roulette else 1.0))

    def settings_at(self, depth: int) -> Settings:
        """The settings with what is special at the first and the last bounce."""
        return self.settings._replace(hide_emitters=self.settings.hide_emitters and depth == 0,
                                      last=depth + 1 >= self.max_depth)


def take_step(integrand: Integrand, state: PathState, depth: int, step: Step | None = None,
              hit: Hit | None = None) -> tuple[Vertex, Step]:
    """One bounce of every lane; rays are cast only if `step` and `hit` do not hold their answers."""
    if hit is None:
        hit = first_hit(integrand, state.ray, depth) if step is None else step.hit
    settings = integrand.settings_at(depth)._replace(moving=False, sampling="detached")
    vertex = integrand.bounce(integrand.scene, integrand.proposal, state, hit, integrand.at(depth), settings)
    if step is None:
        connects = settings.nee and not settings.last
        visible = ~integrand.caster.occluded(vertex.shadow, vertex.shadow_distance) if connects else (
            torch.zeros_like(vertex.survives))
        step = Step(hit, visible, vertex.survives)
    return vertex, step


def survivors(state: PathState, step: Step) -> PathState:
    """The lanes of the next bounce's `state` that go on, packed together."""
    alive = surviving(step)
    return state if len(alive) == len(state.lane) else rows(state, alive)


def surviving(step: Step) -> Tensor:
    """Indices of the lanes that go on, int64."""
    return step.survives.nonzero().squeeze(1)


class Bounce(NamedTuple):
    """One turn of the loop over bounces."""

    depth: int
    state: PathState  # that reached it
    vertex: Vertex
    step: Step


def bounces(integrand: Integrand, state: PathState, depth: int = 0, steps: Mapping[int, Step] = {}) -> Iterator[Bounce]:
    """The loop over bounces, until every path has ended.

    Args:
        integrand: the scene and how to step.
        state: of the paths that have reached `depth`.
        depth: of the first bounce to take.
        steps: by depth, what was decided before; no ray is cast there.
    """
    while depth < integrand.max_depth and len(state.lane):
        vertex, step = take_step(integrand, state, depth, steps.get(depth))
        yield Bounce(depth, state, vertex, step)
        state, depth = survivors(vertex.next, step), depth + 1


def trace(integrand: Integrand, start: PathState, visit: Callable[[int, PathState, Step], None] | None = None) -> Vec3:
    """The radiance L_1 along each lane's camera ray: the sum of beta_k E_k over bounces.

    Args:
        integrand: the scene and how to step.
        start: from `start_path`.
        visit: called at every depth with the state that reached it and what was decided there.

    Returns:
        (N,) linear RGB, in the order of `start`; attached if `integrand.scene` is.
    """
    L = Vec3.buffer(start.beta.x)
    for depth, state, vertex, step in bounces(integrand, start):
        if visit is not None:
            visit(depth, state, step)
        add_at(L, state.lane, state.beta * (vertex.Le + masked(step.visible, vertex.Ld)))
    return L


def add_at(L: Vec3, lane: Tensor, value: Vec3) -> None:
    """Adds `value` to `L` at `lane`, in place."""
    for total, part in zip(L, value):
        total.index_add_(0, lane, part) if len(lane) < len(total) else total.add_(part)


def first_hit(integrand: Integrand, ray: Ray, depth: int) -> Hit:
    """The closest surface; of camera rays, the closest that the camera is to see."""
    if depth > 0:
        return integrand.caster.intersect(ray)
    return camera_hit(integrand.caster, integrand.proposal, ray, integrand.clipping, integrand.settings.hide_emitters)
