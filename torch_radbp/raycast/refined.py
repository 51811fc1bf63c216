"""Intersects a ray with the plane of the triangle that a less exact query has hit, in the ray's dtype."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_radbp.interface.instances import Instances
from torch_radbp.raycast.protocol import Hit, Ray
from torch_radbp.tensors.vec import Vec3, crossing, dot


def refined(vertices: Tensor, faces: Tensor, ray: Ray, hit: Hit, instances: Instances | None = None) -> Hit:
    """The hit with t and barycentric u and v computed again from the triangle's plane, in the ray's dtype.

    Args:
        vertices: (V, 3).
        faces: (F, 3).
        ray: (N,).
        hit: of these rays; its triangle is kept.
        instances: of parts of the mesh.
    """
    ray = Ray(ray.o.detach(), ray.d.detach())
    corners = vertices.to(ray.o.x.dtype)[faces[hit.prim.clamp(min=0)].long()]
    if instances is not None:
        matrices = instances.by_hit(corners.dtype)[hit.instance.long()]
        corners = (matrices[..., None, :, :3] * corners[..., None, :]).sum(-1) + matrices[..., None, :, 3]
    p0, p1, p2 = (Vec3.of(corners[..., corner, :]) for corner in range(3))
    e1, e2 = p1 - p0, p2 - p0
    volume, of_u, of_v = crossing(ray, p0, e1, e2)
    u, v = of_u / volume, of_v / volume
    t = dot(p0 + e1 * u + e2 * v - ray.o, ray.d) / dot(ray.d, ray.d)
    is_exact = (hit.prim >= 0) & (volume != 0)
    places = (torch.where(is_exact, exact, rough.to(exact.dtype)) for exact, rough in zip((u, v, t), hit[1:4]))
    return Hit(hit.prim, *places, hit.instance)
