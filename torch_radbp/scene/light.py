"""Light that leaves surfaces and surround, and next-event estimation's choice of it."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.sampling.warp import UNIFORM_SPHERE_PDF, square_to_uniform_sphere, square_to_uniform_triangle
from torch_radbp.scene.interaction import SurfaceInteraction
from torch_radbp.scene.lookup import lookup, sample_texture
from torch_radbp.scene.tensors import CONSTANT, POINT, SceneTensors
from torch_radbp.vec import TINY, Ray, Vec2, Vec3, dot, masked, normalize, where

SHADOW_SHORTENING = 1.0 - 1e-3  # a shadow ray ends before the light that it aims at
FAR = 1e10  # the distance of the surround


class LightSample(NamedTuple):
    """A point on a light per lane, seen from a surface."""

    d: Vec3  # unit direction towards it
    radiance: Vec3  # that it sends back (for a point light: intensity / distance^2); attached
    pdf: Tensor  # density over solid angle; probability for a point light; 0: cannot be used
    findable: Tensor | float  # 1: BSDF sampling finds it too; 0: it cannot (a point light)
    target: Vec3  # the point, world space
    distant: Tensor | None  # bool: it is a direction rather than a point; None: it never is


def emitted(scene: SceneTensors, si: SurfaceInteraction) -> Vec3:
    """Radiance that leaves the surface, or the surround, towards the viewer."""
    layout = scene.layout
    radiance = Vec3.full(si.p.x, 0.0)
    if layout.area_lights:
        texture = lookup(scene.triangles.radiance, si.prim)
        emits = si.valid & si.front & (texture >= 0)
        uv = si.uv if layout.radiance_bitmaps else None
        radiance = masked(emits, sample_texture(scene.radiance, texture.clamp_min(0), uv))
    if layout.constant_light:
        surround = scene.lights.surround.expand(si.prim.shape)
        uv = Vec2(torch.zeros_like(si.p.x), torch.zeros_like(si.p.x)) if layout.radiance_bitmaps else None
        radiance = where(si.valid, radiance, sample_texture(scene.radiance, surround, uv))
    return radiance


def emitted_pdf(proposal: SceneTensors, ray: Ray, si: SurfaceInteraction) -> Tensor:
    """Density over solid angle with which next-event estimation at the ray's origin would have found this point."""
    offset = si.p - ray.o
    cosine = dot(si.n, ray.d).abs()
    pdf = lookup(proposal.triangles.light_pdf, si.prim) * dot(offset, offset) / cosine.clamp_min(1e-9)
    if not proposal.layout.constant_light:
        return pdf
    return torch.where(si.valid, pdf, proposal.lights.surround_pmf * UNIFORM_SPHERE_PDF)


def sample_light(scene: SceneTensors, proposal: SceneTensors, si: SurfaceInteraction, choice: Tensor, u: Tensor,
                 v: Tensor) -> LightSample:
    """Picks a light element, and a point on it.

    Args:
        scene: attached; gives the radiance.
        proposal: detached; gives the choice, the point and its density.
        si: where the light is wanted.
        choice, u, v: (N,) uniform numbers.
    """
    layout, lights = scene.layout, proposal.lights
    element = lights.choice.sample(choice)
    pmf = lookup(lights.choice.pmf, element)
    kind = lookup(lights.kind, element)
    texture = lookup(lights.radiance, element)
    uv = None

    target, pdf, findable, scale, is_constant = si.p, torch.zeros_like(pmf), 1.0, 1.0, None
    if layout.area_lights:
        prim = lookup(lights.prim, element)
        triangles = proposal.triangles
        b = square_to_uniform_triangle(u, v)
        e1, e2 = lookup(triangles.e1, prim), lookup(triangles.e2, prim)
        target = lookup(triangles.p0, prim) + e1 * b.x + e2 * b.y
        facing, pdf = area_density(proposal, si.p, target, lookup(triangles.n, prim), prim)
        if layout.light_normals:
            w = 1.0 - b.x - b.y
            shading = (lookup(triangles.n0, prim) * w + lookup(triangles.n1, prim) * b.x
                       + lookup(triangles.n2, prim) * b.y)
            facing = dot(shading, target - si.p) < 0
        pdf = pdf * facing.to(pdf.dtype)
        if layout.radiance_bitmaps:
            w = 1.0 - b.x - b.y
            uv = lookup(triangles.uv0, prim) * w + lookup(triangles.uv1, prim) * b.x + lookup(triangles.uv2, prim) * b.y
    elif layout.radiance_bitmaps:
        uv = Vec2(u, v)
    if layout.point_lights:
        is_point = kind == POINT
        position = lookup(lights.position, element)
        target = where(is_point, position, target)
        reach = position - si.p
        scale = torch.where(is_point, 1.0 / dot(reach, reach).clamp_min(TINY), 1.0)
        pdf = torch.where(is_point, pmf, pdf)
        findable = (~is_point).to(pdf.dtype)
    d = normalize(target - si.p)
    if layout.constant_light:
        is_constant = kind == CONSTANT
        d = where(is_constant, square_to_uniform_sphere(u, v), d)
        pdf = torch.where(is_constant, pmf * UNIFORM_SPHERE_PDF, pdf)

    radiance = sample_texture(scene.radiance, texture, uv) * scale
    return LightSample(d, radiance, pdf, findable, target, is_constant)


def shadow_ray(si: SurfaceInteraction, light: LightSample, epsilon: Tensor) -> tuple[Ray, Tensor]:
    """The ray that checks a connection, and how far; 0 where the sample cannot be used.

    It starts off the surface and aims from there: with the direction taken from the surface point, a lamp shadows itself.
    """
    start = si.offset(light.d, epsilon)
    reach = light.target - start
    squared = dot(reach, reach)
    shorter = torch.rsqrt(squared.clamp_min(TINY))
    aim, length = reach * shorter, squared * shorter * SHADOW_SHORTENING
    if light.distant is not None:
        aim, length = where(light.distant, light.d, aim), torch.where(light.distant, FAR, length)
    return Ray(start, aim), length * (light.pdf > 0).to(length.dtype)


def area_density(proposal: SceneTensors, p: Vec3, target: Vec3, n: Vec3, prim: Tensor) -> tuple[Tensor, Tensor]:
    """Whether a light's point faces `p`, and the density over solid angle of choosing it."""
    reach = target - p
    squared = dot(reach, reach)
    cosine = -dot(reach, n) * torch.rsqrt(squared.clamp_min(TINY))
    return cosine > 0, lookup(proposal.triangles.light_pdf, prim) * squared / cosine.abs().clamp_min(1e-9)
