"""The sliding of points over triangles close to the path vertices that see them; see `vertex.nearby`.

The borders at which light on such a triangle ends move over its points by what they move over the triangle, less what the
points do. In barycentric coordinates the latter is a share of the way of a point that stays in a fixed direction from the
vertex.
"""

from __future__ import annotations

import torch
from torch import Tensor

from torch_radbp.boundary.curve.geometry import Geometry, geometry_of
from torch_radbp.boundary.eye.seen_edges import corners_of, crossed_at
from torch_radbp.boundary.eye.viewpoints import Viewpoints, hits_plain, vertex_at
from torch_radbp.call.render_call import RenderCall
from torch_radbp.raycast.protocol import Hit
from torch_radbp.scene.tables.triangle_corners import clearance
from torch_radbp.tensors.differentiated import detached, primal
from torch_radbp.tensors.vec import TINY, Ray, Vec2, Vec3, dot, interpolated, rows, unit_normal
from torch_radbp.vertex.nearby import Floor, Nearby, slide_at


def less_what_slides(call: RenderCall, number: int, geometry: Geometry, points: Viewpoints, start: Vec3, met: Hit,
                     seen: Vec2) -> Vec2:
    """Border positions less the sliding of the points of their triangles; (N,) barycentric, attached.

    Args:
        call, number: the rendering, and the number of the view.
        geometry: of the call's scene, attached.
        points, start: (N,) the viewpoints, and their positions, detached.
        met: (N,) the triangles on which the border lies.
        seen: (N,) the border positions, attached.
    """
    near, ways = what_slides(call, number, geometry, points, start, met, seen.map(primal))
    return Vec2(*(place.index_add(0, near, -way) for place, way in zip(seen, ways)))


def what_slides(call: RenderCall, number: int, geometry: Geometry, points: Viewpoints, start: Vec3, met: Hit,
                place: Vec2) -> tuple[Tensor, Vec2]:
    """The indices of points that slide over triangles, (K,) int64, and the change of their barycentrics; attached.

    Args:
        call, number, geometry, points, start, met: as for `less_what_slides`.
        place: (N,) barycentric coordinates of the points, detached.
    """
    if geometry.triangles.plain is None:
        return torch.zeros_like(points.hit.prim[:0], dtype=torch.int64), place.map(lambda c: c[:0])
    share, d = share_of_slide(geometry_of(detached(call.scene)), points.standing, start, met, place)
    near = (share > 0.0).nonzero().squeeze(1)
    points, met, share, d = rows((points, met, share, d), near)
    fixed = crossed_at(corners_of(geometry, met), Ray(vertex_at(call, geometry, number, points), d))
    return near, fixed.map(lambda way: share * (way - primal(way)))


def share_of_slide(geometry: Geometry, standing: Hit, start: Vec3, met: Hit, place: Vec2) -> tuple[Tensor, Vec3]:
    """The share by which points slide, 0 if fixed to the triangle and 1 if seen in a fixed direction, (N,), and the unit
    directions to them from the viewpoints; detached.

    Args:
        standing: the triangles of the viewpoints, at positions `start`; -1: in a medium.
        met, place: the triangles of the points, and their barycentric coordinates.
    """
    corners, own = corners_of(geometry, met), corners_of(geometry, standing)
    reach = interpolated(corners, place.x, place.y) - start
    distance = torch.sqrt(dot(reach, reach)).clamp_min(TINY)
    d = reach / distance
    floor = Floor(start, unit_normal(own[1] - own[0], own[2] - own[0]), hits_plain(geometry, standing), clearance(own))
    return slide_at(Nearby(corners, place.x, place.y, d, distance, hits_plain(geometry, met)), floor).share, d
