"""Occluders of the environment for surfaces in view, whose moving borders a derivative may lack.

Light from all around casts soft shadows, without borders on the surface. But the border of what hides the sky lies among the
directions over which light is summed, and when it moves, so does a jump that derivatives of radiance miss.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.rendering import Rendering, ShownTriangles
from torch_radbp.boundary.shadow import APART, ray_from
from torch_radbp.boundary.silhouette import CameraSight
from torch_radbp.raycast.protocol import Hit
from torch_radbp.tensors.vec import Vec2

SIDE = 24  # points are looked for in a grid of this many rows and columns of the image
DIRECTIONS = 48  # in which rays are cast from each point, spread over the sphere
AIMED = 16  # at triangles, as evenly chosen from all shapes
GRAZING = 0.1  # cosine with the normal below which directions are left out: all of them give 1% of a uniform sky's light
GOLDEN_ANGLE = math.pi * (3.0 - math.sqrt(5.0))


class HiddenSky(NamedTuple):
    """S rays from visible points that also see the environment, to occluders of it."""

    receiver: Tensor  # (S,) int64, the triangle on which the point lies
    blocker: Tensor  # (S,) int64, the triangle that the ray hits
    view: Tensor  # (S,) int64, the camera that sees the point


def hidden_sky(rendering: Rendering, receives: Tensor) -> HiddenSky:
    """Finds occluders of the environment for visible points.

    Args:
        rendering: that is about to start.
        receives: (T,) bool, the triangles of its caster whose material scatters light from the sky.
    """
    caster, sights, vertices = rendering.caster, rendering.sights, rendering.seen.vertices
    extent = float((vertices.amax(0) - vertices.amin(0)).max())
    o, d, seen = (torch.cat(part) for part in zip(*map(rays_of, sights)))
    hit = caster.intersect(ray_from(o, d))
    met = (seen & (hit.prim >= 0) & receives[hit.prim.clamp_min(0).long()]).nonzero().squeeze(1)
    p, normal = o[met] + d[met] * hit.t[met, None].double(), normals_at(rendering, hit, met)
    normal = torch.where((normal * d[met]).sum(1, keepdim=True) > 0, -normal, normal)

    towards = torch.cat([spread_directions(len(p), p.device), directions_at(rendering.seen, p)], 1)
    point, number = ((towards * normal[:, None]).sum(-1) > GRAZING).nonzero().unbind(1)
    towards = towards[point, number]
    found = caster.intersect(ray_from(p[point] + APART * extent * towards, towards)).prim.long()
    is_open = torch.zeros(len(p), dtype=torch.bool, device=p.device).index_fill(0, point[found < 0], True)
    hides = (found >= 0) & is_open[point]
    of = met[point[hides]]
    return HiddenSky(hit.prim[of].long(), found[hides], torch.div(of, SIDE * SIDE, rounding_mode="floor"))


def normals_at(rendering: Rendering, hit: Hit, lanes: Tensor) -> Tensor:
    """Unit geometric normals at hits of some rays, world space; (N, 3) float64.

    Args:
        rendering: that is about to start.
        hit: of all rays.
        lanes: (N,) int64, which rays.
    """
    caster = rendering.caster
    corners = caster.vertices[caster.faces[hit.prim[lanes].long()].long()].double()
    if rendering.instances is not None:
        linear = rendering.instances.by_hit(corners.dtype)[hit.instance[lanes].long()][:, :, :3]
        corners = corners @ linear.transpose(1, 2)
    normal = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return torch.nn.functional.normalize(normal, dim=1, eps=1e-300)


def rays_of(sight: CameraSight) -> tuple[Tensor, Tensor, Tensor]:
    """A grid of camera rays: origins and unit directions, (SIDE^2, 3) float64; and (SIDE^2,) bool: the ray exists."""
    film, lens = sight.camera.film, sight.camera.lens
    share = (torch.arange(SIDE, device=film.size_x.device) + 0.5) / SIDE
    y, x = (part.flatten() for part in torch.meshgrid(share * sight.height, share * sight.width, indexing="ij"))
    position = Vec2((x + film.crop_x) / film.size_x, (y + film.crop_y) / film.size_y)
    middle = Vec2(torch.full_like(x, 0.5), torch.full_like(x, 0.5)) if sight.camera.kind.has_aperture else None
    ray, weight = sight.camera.kind.sample_ray(lens, position, middle)
    o, d = (part.stack().double() for part in ray)
    seen = torch.isfinite(d).all(1) if weight is None else torch.isfinite(d).all(1) & (weight > 0)
    return o.expand_as(d), torch.nn.functional.normalize(d, dim=1), seen


def spread_directions(count: int, device: torch.device) -> Tensor:
    """Directions spread over the sphere, rotated from point to point; (count, DIRECTIONS, 3) float64.

    Reference: Swinbank and Purser 2006, "Fibonacci grids".
    """
    number = torch.arange(DIRECTIONS, dtype=torch.float64, device=device)
    z = 1.0 - (2.0 * number + 1.0) / DIRECTIONS
    turn = torch.arange(count, dtype=torch.float64, device=device)[:, None]
    angle, radius = GOLDEN_ANGLE * number + turn, torch.sqrt(1.0 - z * z)
    return torch.stack([radius * torch.cos(angle), radius * torch.sin(angle), z.expand_as(angle)], -1)


def directions_at(shown: ShownTriangles, p: Tensor) -> Tensor:
    """Directions from points to centres of triangles, of all shapes in turn; (N, AIMED, 3) float64."""
    counts = torch.tensor([count for count in shown.counts if count], device=p.device)
    number = torch.arange(len(p) * AIMED, device=p.device)
    shape = number % len(counts)
    triangle = (counts.cumsum(0) - counts)[shape] + torch.div(number, len(counts), rounding_mode="floor") % counts[shape]
    middle = shown.vertices[shown.faces[triangle].long()].double().mean(1).reshape(len(p), AIMED, 3)
    return torch.nn.functional.normalize(middle - p[:, None], dim=-1)
