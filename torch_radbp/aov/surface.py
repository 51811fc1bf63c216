"""AOVs of the surface at the first hit, without its material; attached to ray and geometry."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.raycast.protocol import Hit
from torch_radbp.scene.tables.part import part_of
from torch_radbp.scene.tables.placement import for_lanes, points_in_world
from torch_radbp.scene.tables.scene_tensors import SceneTensors
from torch_radbp.scene.tables.triangle_corners import at_corners, edges
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.stage import stage
from torch_radbp.tensors.vec import Frame, Ray, Vec2, Vec3, attached, dot, interpolated, where
from torch_radbp.vertex.interaction import (
    corner_rows,
    shading_normal,
    triangle_normal,
    unit_normal_shown,
    where_the_ray_goes,
)

Values = tuple[Tensor, ...]  # (N,) one for each channel


class SeenPoint(NamedTuple):
    """The point where a camera ray hits a triangle, (N,) each; undefined where it misses."""

    scene: SceneTensors
    hit: Hit  # barycentric coordinates are attached to the ray
    e1: Vec3  # edges of the triangle, from its first vertex
    e2: Vec3
    p: Vec3
    n: Vec3  # unit geometric normal
    t: Tensor  # distance that the ray has come

    @property
    def uv(self) -> tuple[Vec2, Vec2, Vec2]:
        """The surface coordinates (u, v) at the three vertices."""
        return at_corners(self.scene.triangles.vertices.uv, corner_rows(self.scene, self.hit))


def sight(scene: SceneTensors, ray: Ray, hit: Hit, moving: bool) -> SeenPoint:
    """The point where a ray hits a triangle, with attached edges, normal and distance.

    Args:
        scene: packed with all columns; attached.
        ray: (N,) attached.
        hit: what it met.
        moving: whether ray and geometry carry derivatives: the point stays on the ray.
    """
    triangles = scene.triangles
    p0, e1, e2 = edges(*points_in_world(scene, hit, at_corners(triangles.vertices.p, corner_rows(scene, hit))))
    t, n = hit.t, triangle_normal(scene, hit, e1, e2)
    if moving:
        hit = where_the_ray_goes(ray, p0, e1, e2, hit, hit.prim >= 0)
    p = p0 + e1 * hit.u + e2 * hit.v
    if moving:
        t, n = attached(t, dot(p - ray.o, ray.d)), attached(n, unit_normal_shown(scene, hit, e1, e2))
    return SeenPoint(scene, hit, e1, e2, p, n, t)


def _coordinates(seen: SeenPoint) -> Values:
    """The AOV "uv": surface coordinates."""
    return tuple(interpolated(seen.uv, seen.hit.u, seen.hit.v))


def _tangents(seen: SeenPoint) -> tuple[Vec3, Vec3]:
    """The AOVs "dp_du" and "dp_dv"; where u and v do not span the triangle, any orthonormal tangents."""
    uv0, uv1, uv2 = seen.uv
    d1, d2 = Vec2(uv1.x - uv0.x, uv1.y - uv0.y), Vec2(uv2.x - uv0.x, uv2.y - uv0.y)
    area = d1.x * d2.y - d1.y * d2.x
    spanned = area != 0
    scale = 1.0 / torch.where(spanned, area, 1.0)
    other = Frame.of(seen.n)
    return (where(spanned, (seen.e1 * d2.y - seen.e2 * d1.y) * scale, other.s),
            where(spanned, (seen.e2 * d1.x - seen.e1 * d2.x) * scale, other.t))


def _number(seen: SeenPoint, which: int) -> Values:
    """The AOV "prim_index" or "shape_index", as a floating-point number."""
    triangles = seen.scene.triangles
    number = lookup(triangles.numbers[which], seen.hit.prim.clamp_min(0))
    if which == 1 and triangles.instances is not None:  # shapes of groups have the number 0
        number = number + lookup(triangles.instances.number, seen.hit.instance)
    return number.to(seen.t.dtype),


FUNCTIONS = {
    "depth": lambda seen: (seen.t,),
    "position": lambda seen: tuple(seen.p),
    "uv": _coordinates,
    "geo_normal": lambda seen: tuple(seen.n),
    "sh_normal": lambda seen: tuple(shading_normal(seen.scene, seen.hit, seen.n)),
    "dp_du": lambda seen: tuple(_tangents(seen)[0]),
    "dp_dv": lambda seen: tuple(_tangents(seen)[1]),
    "prim_index": lambda seen: _number(seen, 0),
    "shape_index": lambda seen: _number(seen, 1),
}


def without_materials(scene: SceneTensors) -> SceneTensors:
    """The scene's tables without materials, so that compiled code serves scenes of any materials."""
    triangles = scene.triangles._replace(
        balls=None, along=None, attributes=(), vertices=scene.triangles.vertices._replace(attributes=()),
        instances=for_lanes(scene.triangles.instances))
    return part_of(scene, None)._replace(triangles=triangles)


@stage("scene")
def surface_values(scene: SceneTensors, ray: Ray, hit: Hit, names: tuple[str, ...], moving: bool) -> tuple[Values, ...]:
    """Several AOVs of the surface; 0 where nothing is hit. Args as for `sight`."""
    seen, valid = sight(scene, ray, hit, moving), (hit.prim >= 0).to(hit.t.dtype)
    return tuple(tuple(torch.where(hit.prim >= 0, value, 0.0) if name == "depth" else value * valid
                       for value in FUNCTIONS[name](seen)) for name in names)
