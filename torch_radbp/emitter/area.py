"""A surface that emits light."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from torch_radbp.emitter.surface import SurfaceLight
from torch_radbp.interface.emitter import (
    NEAREST,
    Aim,
    EmittingTriangles,
    Pick,
    RayNumbers,
    ShadowSource,
    SurfaceKind,
    Surrounding,
)
from torch_radbp.interface.emitter_bounds import LightBounds
from torch_radbp.plugin import register
from torch_radbp.sampling.sampler import unit
from torch_radbp.sampling.spheres import towards_spheres
from torch_radbp.sampling.warp import square_to_cosine_hemisphere, square_to_uniform_triangle
from torch_radbp.tensors.differentiated import settled
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.vec import Frame, Vec3, angle_between, attached, dot, interpolated, normalize

SMALLEST_COSINE = 1e-9  # at the surface; keeps densities finite


@dataclass(frozen=True)
class AreaKind(SurfaceKind):
    """Area lights: equal radiance into all directions on the front side; points are sampled uniformly over the area.

    A point that was picked is glued to its triangle, at fixed barycentric coordinates, and the density carries the geometry
    term and the area of the moving triangle: so radiance / density has the derivative of the integral over the surface.

    Reference: Zhang et al. 2020, "Path-Space Differentiable Rendering", section 4; Worchel et al. 2025.
    """

    bounded: ClassVar[bool] = True

    def bounds(self, table: EmittingTriangles, luminance: Tensor) -> LightBounds:
        def fine(v: Vec3) -> Vec3:
            return v.map(lambda c: c.to(luminance))

        corners, n = tuple(map(fine, table.p)), fine(table.n)
        middle = (corners[0] + corners[1] + corners[2]) * (1.0 / 3.0)
        radius = functools.reduce(torch.maximum, (dot(corner - middle, corner - middle) for corner in corners)).sqrt()
        area = table.inverse_area.to(luminance)
        area = torch.where(area > 0, 1.0 / torch.where(area > 0, area, 1.0), 0.0)
        spread = torch.zeros_like(area)
        for shading in table.shading or ():
            spread = torch.maximum(spread, angle_between(fine(shading), n))
        return LightBounds(middle, radius, luminance * area, n, spread, torch.full_like(area, math.pi / 2))

    def aim(self, table: EmittingTriangles, proposal: EmittingTriangles, p: Vec3, pick: Pick) -> Aim:
        row, b = pick.row, square_to_uniform_triangle(unit(pick.u, p.x.dtype), unit(pick.v, p.x.dtype))
        target = interpolated(lookup(table.p, row), b.x, b.y)
        reach = target - p
        squared = dot(reach, reach).clamp_min(NEAREST**2)
        d = reach * torch.rsqrt(squared)
        n = lookup(table.n, row)
        cosine = -dot(d, n)
        facing = cosine > 0
        if table.shading is not None:
            seen = dot(interpolated(lookup(table.shading, row), b.x, b.y), d) < 0
            facing = seen if table.smooth is None else torch.where(lookup(table.smooth, row), seen, facing)
        uv = None if table.uv is None else interpolated(lookup(table.uv, row), b.x, b.y)
        pdf = pick.pmf * lookup(table.inverse_area, row) * squared / cosine.abs().clamp_min(SMALLEST_COSINE)
        return Aim(d, pdf * facing.to(pdf.dtype), target, uv=uv, attributes=table.attributes_at(row, b.x, b.y), n=n)

    def emit(self, table: EmittingTriangles, proposal: EmittingTriangles, pick: Pick, numbers: RayNumbers,
             world: Surrounding) -> Aim:
        """Samples rays: points uniform over the area, directions by the cosine to the normal or towards `world.targets`."""
        row, b = pick.row, square_to_uniform_triangle(*(unit(bits, pick.pmf.dtype) for bits in (pick.u, pick.v)))
        n, sends, across = lookup(table.n, row), None, numbers.across
        target, pdf = interpolated(lookup(table.p, row), b.x, b.y), pick.pmf * lookup(table.inverse_area, row)
        if world.targets:
            d, density, _ = towards_spheres(world.targets, target.map(settled), numbers.target, across)
            sends = dot(n, d).clamp_min(0.0)
        else:
            d, density = Frame.of(n).to_world(square_to_cosine_hemisphere(across.x, across.y)), 1.0 / math.pi
        if numbers.met is not None:
            if sends is None:
                sends = dot(n, settled(d))
                density = density * settled(sends)
            d = attached(d.map(settled), normalize(numbers.met - target))
            sends = dot(n, d).clamp_min(0.0)
        if table.shading is not None:
            front = (dot(interpolated(lookup(table.shading, row), b.x, b.y), d) > 0).to(n.x.dtype)
            front = front if table.smooth is None else torch.where(lookup(table.smooth, row), front, 1.0)
            sends = front if sends is None else sends * front
        uv = None if table.uv is None else interpolated(lookup(table.uv, row), b.x, b.y)
        return Aim(d, pdf * density, target, sends, uv, table.attributes_at(row, b.x, b.y), n=n)

    def sends(self, front: Tensor) -> Tensor:
        return front

    def density(self, table: EmittingTriangles, row: Tensor, pmf: Tensor, distance: Tensor, cosine: Tensor) -> Tensor:
        density = pmf * lookup(table.inverse_area, row)
        return density * (distance * distance) / cosine.abs().clamp_min(SMALLEST_COSINE)

    def source(self, middle: Tensor, axis: Tensor) -> ShadowSource:
        return ShadowSource(torch.cat([middle, middle.new_ones(1)]), axis)


@register("emitter", "area")
class Area(SurfaceLight):
    """Emits `radiance` (W / (m^2 sr)) from the front side of the shape that carries it.

    Parameters: `radiance`, a texture. Derivatives: with respect to its texels.
    """

    def kind(self) -> AreaKind:
        return AreaKind()
