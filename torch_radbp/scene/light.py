"""Light emitted by surfaces and surround, and how next-event estimation samples it."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.sampling.sampler import fine_unit, unit
from torch_radbp.sampling.warp import UNIFORM_SPHERE_PDF, square_to_uniform_sphere, square_to_uniform_triangle
from torch_radbp.scene.environment import environment_radiance, environment_weighing, sample_environment
from torch_radbp.scene.interaction import SurfaceInteraction, interpolated
from torch_radbp.lookup import lookup
from torch_radbp.texture.bank import sample_texture
from torch_radbp.scene.posed_light import NEAREST, illumination
from torch_radbp.scene.tensors import CONSTANT, DIRECTIONAL, ENVIRONMENT, POINT, SceneTensors
from torch_radbp.vec import TINY, Ray, Vec2, Vec3, dot, masked, where

SHADOW_SHORTENING = 1.0 - 1e-3  # a shadow ray ends just before its light
FAR = 1e10  # the distance of the surround
SMALLEST_COSINE = 1e-9  # at a light's surface; keeps densities finite


class LightSample(NamedTuple):
    """A point on a light per lane, as seen from a surface; attached to the surface point and to the light."""

    d: Vec3  # unit direction towards it; fixed for the surround
    radiance: Vec3  # that it sends back (for a light without extent: intensity / distance^2, or irradiance)
    pdf: Tensor  # density over solid angle; probability for a light without extent; 0: cannot be used
    weighing: Tensor  # used instead of `pdf` in the weights of multiple importance sampling
    findable: Tensor | float  # 1: BSDF sampling can find it too; 0: it cannot (a light without extent)
    target: Vec3  # the point, world space
    distant: Tensor | None  # bool: it is a direction rather than a point; None: it never is


class LightNumbers(NamedTuple):
    """The random numbers of a light sample, (N,) int32 random bits each."""

    choice: Tensor  # picks an element
    split: Tensor  # decides between it and its other
    u: Tensor  # picks a point on it
    v: Tensor


class Aim(NamedTuple):
    """The direction of a light sample, as one kind of light chooses it."""

    d: Vec3
    pdf: Tensor
    target: Vec3 | None = None  # None: far away
    strength: Tensor | None = None  # factor of the light's texture; None: 1
    uv: Vec2 | None = None  # where to read that texture; None: it is one texel


def emitted(scene: SceneTensors, ray: Ray, si: SurfaceInteraction) -> Vec3:
    """Radiance that leaves the surface, or the surround, towards the ray's origin; attached to texels, pose and `ray.d`."""
    radiance = emitted_by_surface(scene, si)
    return where(si.valid, radiance, emitted_by_surround(scene, ray)) if scene.layout.surround else radiance


def emitted_by_surface(scene: SceneTensors, si: SurfaceInteraction) -> Vec3:
    """Radiance that leaves the surfaces that rays have met, towards the rays' origins; 0 where they met none. Attached."""
    layout = scene.layout
    if not layout.area_lights:
        return Vec3.full(si.p.x, 0.0)
    emits = si.valid & si.front & (si.emitter >= 0)
    texture = lookup(scene.lights.surfaces.radiance, si.emitter.clamp_min(0))
    uv = si.uv if layout.radiance_bitmaps else None
    return masked(emits, sample_texture(scene.radiance, texture, uv))


def emitted_by_surround(scene: SceneTensors, ray: Ray) -> Vec3:
    """Radiance that the surround sends along rays that meet nothing, back to their origins; attached to `ray.d` as well."""
    layout, d = scene.layout, ray.d
    if layout.environment_map:
        return environment_radiance(scene, d)
    if not layout.constant_light:
        return Vec3.full(d.x, 0.0)
    uv = Vec2(torch.zeros_like(d.x), torch.zeros_like(d.x)) if layout.radiance_bitmaps else None
    return sample_texture(scene.radiance, scene.lights.surround.expand(d.x.shape), uv)


def emitted_pdf(scene: SceneTensors, ray: Ray, si: SurfaceInteraction, proposal: SceneTensors | None = None) -> Tensor:
    """Density over solid angle with which next-event estimation at the ray's origin would have found this point.

    For weights only: that of an environment map is `environment_weighing`.

    Args:
        scene: gives geometry.
        ray, si: what the ray meets. The density is attached if these arguments are.
        proposal: gives the probabilities of picking a light, and the environment map with its pose; None: `scene`.
    """
    proposal = scene if proposal is None else proposal
    pdf = pdf_of_surface(scene, si, proposal)
    return torch.where(si.valid, pdf, pdf_of_surround(proposal, ray)) if scene.layout.surround else pdf


def pdf_of_surface(scene: SceneTensors, si: SurfaceInteraction, proposal: SceneTensors) -> Tensor:
    """`emitted_pdf` of rays that meet a surface."""
    if not scene.layout.area_lights:
        return torch.zeros_like(si.t)
    row, emits = si.emitter.clamp_min(0), (si.emitter >= 0).to(si.t.dtype)
    density = lookup(proposal.lights.surfaces.pmf, row) * lookup(scene.lights.surfaces.inverse_area, row)
    return density * emits * (si.t * si.t) / si.cosine.abs().clamp_min(SMALLEST_COSINE)


def pdf_of_surround(proposal: SceneTensors, ray: Ray) -> Tensor:
    """`emitted_pdf` of rays that meet nothing."""
    if proposal.layout.environment_map:
        return proposal.lights.surround_pmf * environment_weighing(proposal, ray.d)
    if proposal.layout.constant_light:
        return (proposal.lights.surround_pmf * UNIFORM_SPHERE_PDF).expand(ray.d.x.shape)
    return torch.zeros_like(ray.d.x)


def sample_light(scene: SceneTensors, proposal: SceneTensors, si: SurfaceInteraction, numbers: LightNumbers) -> LightSample:
    """Picks a light element, and a point on it.

    The point is glued to its light: element and barycentric coordinates, or the direction of the surround, are decided by
    `proposal`, and the point moves with `scene`. `pdf` then carries the geometry term and the area of the moving light, so
    that radiance / pdf has the derivative of the integral over the light's surface.

    Args:
        scene: attached; gives geometry, poses and radiance.
        proposal: detached; gives every choice.
        si: where the light is wanted, attached or not.
        numbers: decide.

    Reference: Zhang et al. 2020, "Path-Space Differentiable Rendering", section 4; Worchel et al. 2025.
    """
    layout, lights = scene.layout, proposal.lights
    dtype = si.p.x.dtype
    u, v = unit(numbers.u, dtype), unit(numbers.v, dtype)
    element = lights.choice.sample(numbers.choice, unit(numbers.split, dtype))
    pmf = lookup(lights.choice.pmf, element)
    kind = None if layout.only_surfaces_emit else lookup(lights.kind, element)

    # Let each kind of light that there is decide where to look.
    aim, fixed = None, None
    if layout.area_lights:
        aim = aim_at_area(scene, si.p, pmf, lookup(lights.surface, element), square_to_uniform_triangle(u, v))
    if layout.posed_lights:
        aim = mixed(kind >= POINT, aim_at_posed(scene, si.p, pmf, lookup(lights.pose, element), kind), aim)
    if layout.constant_light:
        aim = mixed(kind == CONSTANT, Aim(square_to_uniform_sphere(u, v), pmf * UNIFORM_SPHERE_PDF), aim)
    if layout.environment_map:
        fixed, density = sample_environment(proposal, fine_unit(numbers.u), fine_unit(numbers.v))
        aim = mixed(kind == ENVIRONMENT, Aim(fixed, pmf * density), aim)

    # Look up what is sent from there.
    radiance = sample_texture(scene.radiance, lookup(lights.radiance, element), aim.uv)
    if aim.strength is not None:
        radiance = radiance * aim.strength
    if fixed is not None:
        radiance = where(kind == ENVIRONMENT, environment_radiance(scene, fixed), radiance)

    weighing = aim.pdf
    if fixed is not None:
        weighing = torch.where(kind == ENVIRONMENT, pmf * environment_weighing(proposal, fixed), weighing)
    findable = (kind < POINT).to(pmf.dtype) if layout.posed_lights else 1.0
    distant = None
    if layout.distant_lights:
        distant = (kind == CONSTANT) | (kind == ENVIRONMENT) | (kind == DIRECTIONAL)
    return LightSample(aim.d, radiance, aim.pdf, weighing, findable, si.p if aim.target is None else aim.target, distant)


def aim_at_area(scene: SceneTensors, p: Vec3, pmf: Tensor, row: Tensor, b: Vec2) -> Aim:
    """From `p` at the point of the emitting triangles `row` with barycentric coordinates `b`, attached to both ends."""
    layout, triangles = scene.layout, scene.lights.surfaces
    target = interpolated(tuple(lookup(corner.p, row) for corner in triangles.corners), b.x, b.y)
    reach = target - p
    squared = dot(reach, reach).clamp_min(NEAREST**2)
    d = reach * torch.rsqrt(squared)
    cosine = -dot(d, lookup(triangles.n, row))
    facing = cosine > 0
    if layout.light_normals:
        shading = interpolated(tuple(lookup(corner.n, row) for corner in triangles.corners), b.x, b.y)
        seen = dot(shading, d) < 0
        facing = seen if triangles.smooth is None else torch.where(lookup(triangles.smooth, row), seen, facing)
    uv = None
    if layout.radiance_bitmaps:
        uv = interpolated(tuple(lookup(corner.uv, row) for corner in triangles.corners), b.x, b.y)
    pdf = pmf * lookup(triangles.inverse_area, row) * squared / cosine.abs().clamp_min(SMALLEST_COSINE)
    return Aim(d, pdf * facing.to(pdf.dtype), target, uv=uv)


def aim_at_posed(scene: SceneTensors, p: Vec3, pmf: Tensor, row: Tensor, kind: Tensor) -> Aim:
    """From `p` at the lights without extent in `row` of their table, attached to both ends."""
    light = illumination(scene, p, row, kind)
    return Aim(light.d, pmf, light.place, light.strength, light.uv if scene.layout.radiance_bitmaps else None)


def mixed(condition: Tensor, a: Aim, b: Aim | None) -> Aim:
    """`a` where the condition holds, else `b`; `a` if there is no other."""
    if b is None:
        return a
    target = a.target if b.target is None else b.target
    if a.target is not None and b.target is not None:
        target = where(condition, a.target, b.target)
    strength = None
    if a.strength is not None or b.strength is not None:
        strength = torch.where(condition, *(1.0 if aim.strength is None else aim.strength for aim in (a, b)))
    uv = a.uv if b.uv is None else b.uv
    if a.uv is not None and b.uv is not None:
        uv = Vec2(torch.where(condition, a.uv.x, b.uv.x), torch.where(condition, a.uv.y, b.uv.y))
    return Aim(where(condition, a.d, b.d), torch.where(condition, a.pdf, b.pdf), target, strength, uv)


def shadow_ray(si: SurfaceInteraction, light: LightSample) -> tuple[Ray, Tensor]:
    """The ray that checks a connection, and how far; 0 where the sample cannot be used. Detached if `si` is.

    It starts off the surface and aims from there: with the direction taken from the surface point, a lamp shadows itself.
    """
    d = light.d.detach()
    start = si.offset(d)
    reach = light.target.detach() - start
    squared = dot(reach, reach)
    shorter = torch.rsqrt(squared.clamp_min(TINY))
    aim, length = reach * shorter, squared * shorter * SHADOW_SHORTENING
    if light.distant is not None:
        aim, length = where(light.distant, d, aim), torch.where(light.distant, FAR, length)
    return Ray(start, aim), length * (light.pdf.detach() > 0).to(length.dtype)
