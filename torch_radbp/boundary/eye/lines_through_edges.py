"""BSDF and solid angle along lines from viewpoints through edges.

Rays that tell what lies right beside an edge pass it a little off. Close to the edge they differ much from the line through
it, which the border of a cut follows: a plane that the line meets nearly edge-on and far away may be met nearby by the ray.
What is multiplied with the course of the border is therefore of the line; the ray tells only what is seen beside it.
"""

from __future__ import annotations

import torch
from torch import Tensor

from torch_radbp.boundary.curve.geometry import geometry_of, largest_coordinate
from torch_radbp.boundary.curve.intersections import TOUCHING
from torch_radbp.boundary.eye.seen_edges import corners_of
from torch_radbp.boundary.eye.viewpoints import Viewpoints, path_of
from torch_radbp.call.render_call import RenderCall
from torch_radbp.path.direct_light import scattered_light
from torch_radbp.path.integrand import Integrand
from torch_radbp.raycast.protocol import Hit
from torch_radbp.scene.tables.scene_tensors import SceneTensors
from torch_radbp.tensors.vec import TINY, Ray, Vec3, cross, dot, normalize


def scattered_towards(call: RenderCall, integrand: Integrand, points: Viewpoints, reach: Vec3) -> Vec3:
    """The BSDF times cosine of viewpoints, (N,), for directions `reach` of any length, float64; detached."""
    d = normalize(reach).map(lambda c: c.to(integrand.proposal.dtype).contiguous())
    return scattered_light(integrand, path_of(call, points.ray, points.key), points.hit, d, points.flight)


def solid_angle(scene: SceneTensors, hit: Hit, line: Ray) -> Tensor:
    """(N,) float64, the solid angle per unit of barycentric coordinates where lines meet hit triangles; 1 without a hit.

    Args:
        scene: detached.
        hit: (N,) the hit triangles.
        line: (N,) float64, with directions of any length.
    """
    corners, d = corners_of(geometry_of(scene), hit), normalize(line.d)
    n, height = height_over_plane(corners, line.o)  # n: twice the area of the triangle, which u and v count in
    facing = dot(n, d).abs()
    per_distance = facing / height.clamp_min(TINY)
    return torch.where(hit.prim >= 0, torch.where(height > 0, facing * per_distance * per_distance, 0.0), 1.0)


def height_over_plane(corners: tuple[Vec3, Vec3, Vec3], p: Vec3) -> tuple[Vec3, Tensor]:
    """The normals of triangles, as long as twice their area, and the heights of points over their planes in the same unit.

    A point that lies in the plane up to rounding has a height of 0: from there nothing of the triangle is seen. Otherwise
    the solid angle, which is rounding error there, would be multiplied with the diverging speed of the intersection.

    Args:
        corners: of the triangles, (N,) world, float64, detached.
        p: (N,) world points, float64, detached.
    """
    n = cross(corners[1] - corners[0], corners[2] - corners[0])
    height = dot(n, corners[0] - p).abs()
    least = TOUCHING * largest_coordinate(p, *corners) * torch.sqrt(dot(n, n))
    return n, torch.where(height > least, height, 0.0)
