"""Edges whose shadow borders lie in view of a camera, for warnings."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.edges import Edges
from torch_radbp.boundary.silhouette import CameraSight, crosses_view, outlines_seen
from torch_radbp.raycast.protocol import RayCaster
from torch_radbp.tensors.vec import Ray, Vec3

PLACES = (0.1, 0.3, 0.5, 0.7, 0.9)  # along each edge, from which rays are cast
MOST_EDGES = 1 << 14  # that are examined
FAR_AWAY = 1e4  # extents of the mesh: the distance at which a light in a direction is placed
APART = 1e-4  # distance from the edge at which a ray starts, as a share of the scene's extent


class Shadows(NamedTuple):
    """S visible points on shadow borders."""

    edge: Tensor  # (S,) int64, the edge that casts the shadow
    receiver: Tensor  # (S,) int64, the triangle on which the shadow falls
    seen: Tensor  # (views, S) bool: seen by that camera


def shadows_in_view(edges: Edges, vertices: Tensor, caster: RayCaster, light: Tensor, axis: Tensor,
                    sights: Sequence[CameraSight], own: Tensor | None = None) -> Shadows:
    """Finds shadow borders of a light in some views; those hidden behind surfaces included.

    Args:
        edges: of the scene.
        vertices: (V, 3) of the scene as it is now, world space, detached.
        caster: of the same scene.
        light: (4,) homogeneous coordinates of the light: a position, or with 0 at the end the direction towards it.
        axis: (3,) the light shines only into directions on this side; 0: into all.
        sights: of the cameras.
        own: (T,) bool, the triangles that emit the light, which do not hide it: its middle may lie inside; None: there are
            none.
    """
    extent = (vertices.amax(0) - vertices.amin(0)).max().double()
    vertices = vertices.double()
    light, position = light.double(), viewpoint(light.double(), vertices)
    outline = outlines_seen(edges, vertices, light).nonzero().squeeze(1)
    edge = outline[::max(1, -(-len(outline) // MOST_EDGES))].repeat(len(PLACES))
    share = vertices.new_tensor(PLACES).repeat_interleave(len(edge) // len(PLACES))[:, None]
    place = vertices[edges.a[edge]] * (1.0 - share) + vertices[edges.b[edge]] * share
    reach = place - position
    distance = reach.norm(dim=1)
    d = reach / distance.clamp_min(1e-300)[:, None]
    lit = d @ axis.double() >= 0
    towards, before = ray_from(place - d * APART * extent, -d), (distance - 2 * APART * extent).float()
    if own is None:
        lit &= ~caster.occluded(towards, before)
    else:
        met = caster.intersect(towards)
        lit &= (met.prim < 0) | (met.t >= before) | own[met.prim.long().clamp_min(0)]
    hit = caster.intersect(ray_from(place + d * APART * extent, d))
    border = place + d * (APART * extent + hit.t[:, None].double())
    falls = (lit & (hit.prim >= 0)).nonzero().squeeze(1)
    points = Vec3.of(border[falls])
    seen = torch.stack([crosses_view(points, points, sight) for sight in sights])
    falls, seen = falls[seen.any(0)], seen[:, seen.any(0)]
    return Shadows(edge[falls], hit.prim[falls].long(), seen)


def viewpoint(place: Tensor, vertices: Tensor) -> Tensor:
    """A position for a light, (3,); a directional one is moved far away from the mesh.

    Args:
        place: (4,) homogeneous: a position, or with 0 at the end the direction towards it; float64.
        vertices: (V, 3) of the mesh, float64.
    """
    if place[3]:
        return place[:3]
    extent = (vertices.amax(0) - vertices.amin(0)).max()
    return vertices.mean(0) + FAR_AWAY * extent * place[:3]


def ray_from(o: Tensor, d: Tensor) -> Ray:
    """Float32 rays from (N, 3) points in (N, 3) directions."""
    return Ray(*(Vec3(*part.float().contiguous().unbind(1)) for part in (o, d)))
