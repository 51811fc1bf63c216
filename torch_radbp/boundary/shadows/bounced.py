"""Borders of shadows of light without extent, as they are seen by vertices of paths.

Light from points and single directions reaches a surface through next-event estimation alone, so that its shadows have hard
borders on every surface that a path meets. Those on the first are counted in `border.py`. On the next, x_{k+1}, glued
to its surface, what vertex x_k receives from there is

    integral of f |cos x_k| |cos x_{k+1}| / r^2  L(x_{k+1}) dA

and L jumps at the border, which moves over the surface as it does over the film there; the points of a surface close to x_k
slide (`slid.py`). Each place on a border is connected to one vertex of a path.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.geometry import Geometry, geometry_of
from torch_radbp.boundary.outline import Outline
from torch_radbp.boundary.shadows.border import Borders, Lights, borders_of, light_through, seen_at
from torch_radbp.boundary.shadows.film_jumps import FilmJumps, attached_geometry, swept
from torch_radbp.boundary.shadows.seen_edges import BEFORE, Casting, corners_of, crossed_at, numbers, pace, unhidden
from torch_radbp.boundary.shadows.slid import less_what_slides
from torch_radbp.boundary.shadows.viewpoints import Viewpoints, path_of, vertex_at, viewpoints
from torch_radbp.call.render_call import RenderCall, integrand_of
from torch_radbp.path.direct_light import light_sent_back, scattered_light
from torch_radbp.path.integrand import Integrand
from torch_radbp.sampling.sampler import LaneKey
from torch_radbp.scene.tensors import SceneTensors
from torch_radbp.tensors.vec import TINY, Ray, Vec2, Vec3, cross, dot, interpolated, rows

SHARE = 16  # one place for so many paths of the image
SALT = 0x2B3E6C1F  # tells the random numbers that connect borders with paths from others


class ConnectedBorders(NamedTuple):
    """K places on borders, each connected to a vertex of a path; detached."""

    points: Viewpoints  # these
    start: Vec3  # where they are, world
    borders: Borders
    normal: Vec2  # in the coordinates of `on_receiver`, as long as the piece that a place stands for
    strength: Tensor  # (3, K) float64, the difference of what the path receives from behind and ahead


def jumps_in_view(call: RenderCall, number: int, casting: Casting, found: ConnectedBorders) -> FilmJumps:
    """What such borders add to the derivative of view `number`; args as of `border.jumps_in_view`."""
    geometry = attached_geometry(call.scene)
    seen = on_receiver(call.scene, geometry, casting.outline, found.borders)
    seen = less_what_slides(call, number, geometry, found.points, found.start, found.borders.receiver, seen)
    return FilmJumps(found.points.place, found.strength * swept(seen, found.normal))


def on_receiver(scene: SceneTensors, geometry: Geometry, outline: Outline, borders: Borders, step: Tensor | float = 0.0,
                off: Vec3 | None = None) -> Vec2:
    """Where shadows end on their receivers, (N,) barycentric coordinates there, attached; args as for `border`."""
    return crossed_at(corners_of(geometry, borders.receiver), light_through(scene, geometry, outline, borders, step, off))


def borders_of_paths(call: RenderCall, number: int, casting: Casting, effort: float) -> ConnectedBorders | None:
    """Places on borders, each connected to a vertex of a path of view `number`; args as of `border.borders_in_view`."""
    view, scene = call.views[number], call.scene
    found = borders_of(call, number, casting, effort, Lights(sharp=True, soft=False, around=False), SHARE)
    if found is None:
        return None
    borders, passed, inwards, times = rows(found, unhidden(call.integrand, found.passed))
    if not len(times):
        return None
    integrand = integrand_of(call, call.integrand, number)
    points = viewpoints(call, number, integrand._replace(max_depth=integrand.max_depth - 1), len(times))
    if not len(points.depth):
        return None
    geometry = geometry_of(scene)
    here, along = pace(lambda step: on_receiver(scene, geometry, casting.outline, borders, step), times)
    shade = on_receiver(scene, geometry, casting.outline, borders, off=inwards)
    scale = times * len(points.depth)
    normal = Vec2(-along.y * scale, along.x * scale)
    ahead = (shade.x - here.x) * normal.x + (shade.y - here.y) * normal.y > 0
    place = torch.arange(len(times), dtype=torch.int32, device=scene.device)
    connected = (numbers(view.sample_keys[1], place, SALT, torch.float64) * len(points.depth)).long()
    own = rows(points, connected)
    start = rows(vertex_at(call, geometry, number, points), connected)
    light = light_received(call, integrand, own, start, borders, here, passed.key)
    light = torch.where(torch.isfinite(normal.x) & torch.isfinite(normal.y), light, 0.0)
    kept = (light != 0).any(0).nonzero().squeeze(1)
    if not len(kept):
        return None
    light, ahead = light[:, kept], ahead[kept]
    return ConnectedBorders(*rows((own, start, borders, normal), kept), torch.where(ahead, light, -light))


def light_received(call: RenderCall, integrand: Integrand, points: Viewpoints, at: Vec3, borders: Borders, here: Vec2,
                   key: LaneKey) -> Tensor:
    """(3, N) float64 what the view sees of the light that vertices of paths receive from borders, unless it is shadowed.

    Args:
        points, at: the vertices, and where they are; (N,).
        borders, here: what they are connected to, and where that is on its triangle.
        key: (N,) of random numbers.
    """
    scene, dtype = integrand.proposal, integrand.proposal.dtype
    corners = corners_of(geometry_of(scene), borders.receiver)
    x = interpolated(corners, here.x, here.y)
    reach = x - at
    squared = dot(reach, reach).clamp_min(TINY)
    distance = torch.sqrt(squared)
    d = reach / distance
    ray = Ray(*(part.map(lambda c: c.to(dtype).contiguous()) for part in (at, d)))
    start = (at + reach * BEFORE).map(lambda c: c.to(dtype).contiguous())
    free = ~integrand.caster.occluded(Ray(start, ray.d), (distance * (1.0 - 2.0 * BEFORE)).to(dtype))
    beta = points.beta * scattered_light(integrand, path_of(call, points.ray, points.key), points.hit, ray.d)
    light = light_sent_back(integrand, path_of(call, ray, key), seen_at(borders.receiver, ray, x), borders.draw)
    n = cross(corners[1] - corners[0], corners[2] - corners[0])  # twice the area of the triangle, which u and v count in
    return torch.stack(tuple(beta * light)).double() * (free * (dot(n, d).abs() / squared))
