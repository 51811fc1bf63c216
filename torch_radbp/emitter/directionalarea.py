"""A surface that emits parallel light."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from torch_radbp.emitter.surface import SurfaceLight
from torch_radbp.interface.emitter import Aim, EmittingTriangles, Pick, RayNumbers, ShadowSource, SurfaceKind, Surrounding
from torch_radbp.plugin import register
from torch_radbp.sampling.sampler import unit
from torch_radbp.sampling.warp import square_to_uniform_triangle
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.vec import Ray, Vec3, crossing, dot, interpolated


@dataclass(frozen=True)
class DirectionalAreaKind(SurfaceKind):
    """Surfaces that emit parallel light along their normals: a point is lit from the foot of its perpendicular on them."""

    delta: ClassVar[bool] = True
    parallel: ClassVar[bool] = True
    aimed: ClassVar[bool] = False

    def check(self, triangles: EmittingTriangles) -> None:
        if triangles.shading is not None:
            raise ValueError("a directionalarea emitter belongs to a shape with flat faces, whose beams are those of its "
                             "triangles, got one with normals of its vertices; set face_normals or take an area emitter")

    def aim(self, table: EmittingTriangles, proposal: EmittingTriangles, p: Vec3, pick: Pick) -> Aim:
        n, corners = lookup(table.n, pick.row), lookup(table.p, pick.row)
        p0, e1, e2 = corners[0], corners[1] - corners[0], corners[2] - corners[0]
        volume, of_u, of_v = crossing(Ray(p, -n), p0, e1, e2)
        met = volume.abs() > 0
        volume = torch.where(met, volume, 1.0)
        u, v = of_u / volume, of_v / volume
        met = met & (dot(p - p0, n) > 0) & (u >= 0) & (v >= 0) & (u + v <= 1)
        # What no beam meets has a finite target and texture coordinates all the same.
        u, v = torch.where(met, u, 0.25), torch.where(met, v, 0.25)
        uv = None if table.uv is None else interpolated(lookup(table.uv, pick.row), u, v)
        return Aim(-n, pick.pmf * met.to(pick.pmf.dtype), interpolated(corners, u, v), uv=uv,
                   attributes=table.attributes_at(pick.row, u, v))

    def emit(self, table: EmittingTriangles, proposal: EmittingTriangles, pick: Pick, numbers: RayNumbers,
             world: Surrounding) -> Aim:
        row, b = pick.row, square_to_uniform_triangle(*(unit(bits, pick.pmf.dtype) for bits in (pick.u, pick.v)))
        n, uv = lookup(table.n, row), None if table.uv is None else interpolated(lookup(table.uv, row), b.x, b.y)
        return Aim(n, pick.pmf * lookup(table.inverse_area, row), interpolated(lookup(table.p, row), b.x, b.y), uv=uv,
                   attributes=table.attributes_at(row, b.x, b.y), n=n)

    def source(self, middle: Tensor, axis: Tensor) -> ShadowSource:
        towards = -torch.nn.functional.normalize(axis, dim=0)
        return ShadowSource(torch.cat([towards, towards.new_zeros(1)]), torch.zeros_like(axis))


@register("emitter", "directionalarea")
class DirectionalArea(SurfaceLight):
    """Emits a beam along the normal from the front side of the flat shape that carries it.

    A surface across the beam receives the irradiance `radiance` (W / m^2) at any distance. The shape itself looks black.
    Mitsuba's particle tracer renders the same; its path tracers, which do not look for the foot of the perpendicular, see no
    light at all.

    Parameters: `radiance`, a texture. Derivatives: with respect to the texels and to the shape, except for the contribution
    of the edge of the beam, where the light is discontinuous.
    """

    def kind(self) -> DirectionalAreaKind:
        return DirectionalAreaKind()
