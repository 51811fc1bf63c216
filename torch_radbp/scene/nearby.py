"""How a path's next vertex moves where it lies close to the last one.

A vertex y that is glued to its triangle is seen from the last vertex x in a direction that turns by (y' - x') / r. Where
surfaces meet that move apart, or x slides over one of them, samples of a derivative are then as large as 1 / r, and their
variance is infinite. So a vertex that is near lets go of its triangle: it slides over it by a share m of the way by which it
would stay in the fixed direction from x. With G the turning of the direction to the glued vertex, directions turn by

    V = (1 - m) G,    div V = (1 - m) div G - grad m . G

over solid angle, the second of which is the change of the element of solid angle. As a function of y's barycentric
coordinates (u, v), which change by (u', v') in a fixed direction, it is (1 - m) div G + m_u u' + m_v v'.

Any m may be chosen that is continuous over a triangle and 0 along its edges: then no edge and no other surface sees anything
of it, and only borders that lie inside of triangles move differently over points that slide (`boundary/shadows/slid.py`).
Here m is near 1 within some distance of x and away from edges,

    m = (1 - r^2 / R^2)^2 s_1 s_2 s_3

with R a share of the least height of the triangle, and s_i rising smoothly from 0 at an edge to 1 at twice r. The rise must
be wide: at grazing angles points slide much faster than x, and where a wall that ends stands on a floor they come as near to
the ends as x does. Edges in the plane of x, along which surfaces touch, need no s_i: light along that plane does not count.
Triangles at which light jumps for other reasons than shadows are *not plain*, and vertices stay glued to them.

Reference: Zhang et al. 2020, "Path-Space Differentiable Rendering", section 4 (any continuous motion of the points serves);
Bangaru, Li and Durand 2020, "Unbiased Warped-Area Sampling for Differentiable Rendering" (fields that follow edges).
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.tensors.vec import TINY, Vec3, cross, dot

REACH = 0.2  # of the least height of a triangle: how near x must be
BORDER = 2.0  # times the distance of x: how far from an edge the share is less

Corners = tuple[Vec3, Vec3, Vec3]


class Slide(NamedTuple):
    """How much points of triangles slide, (N,); detached."""

    share: Tensor  # m; 0: glued
    by_u: Tensor  # how that changes with the barycentric coordinate of the second vertex
    by_v: Tensor  # and of the third


class Nearby(NamedTuple):
    """Points of triangles as they are seen from other points, (N,); detached."""

    corners: Corners  # of the triangle, world
    u: Tensor  # barycentric coordinates: of the second vertex
    v: Tensor  # of the third
    d: Vec3  # unit, from x to the point
    distance: Tensor
    plain: Tensor  # bool: the triangle is


class Floor(NamedTuple):
    """The surfaces of x, (N,); detached."""

    p: Vec3  # x
    n: Vec3  # unit normal
    plain: Tensor  # bool: the triangle is, so that light along its plane does not count
    clearance: Tensor  # by which points in its plane may seem to lie off it


def heights_of(corners: Corners) -> tuple[Tensor, Tensor, Tensor]:
    """The heights of triangles over the edges opposite each of their vertices, (N,) each; detached."""
    p0, p1, p2 = (corner.detach() for corner in corners)
    e1, e2 = p1 - p0, p2 - p0
    n, across = cross(e1, e2), e2 - e1
    size = torch.sqrt(dot(n, n))
    return tuple(size * torch.rsqrt(dot(edge, edge).clamp_min(TINY)) for edge in (across, e2, e1))


def slides_from(corners: Corners, distance: Tensor, plain: Tensor) -> Tensor:
    """True where points of triangles may slide that are seen from this distance; (N,) bool. Args as of `Nearby`."""
    return plain & (distance < REACH * least(heights_of(corners)))


def least(heights: tuple[Tensor, Tensor, Tensor]) -> Tensor:
    return torch.minimum(torch.minimum(heights[0], heights[1]), heights[2])


def slide_at(near: Nearby, floor: Floor) -> Slide:
    """How much points slide that are seen from near x."""
    p0, p1, p2 = corners = tuple(corner.detach() for corner in near.corners)
    e1, e2 = p1 - p0, p2 - p0
    heights = heights_of(corners)
    height = least(heights).clamp_min(TINY)
    reach = near.distance / (REACH * height)
    left = (1.0 - reach * reach).clamp_min(0.0)
    seen = dot(cross(e1, e2), near.d).abs() > TINY
    fall = left * left * (near.plain & seen).to(left.dtype)
    steep = -4.0 * left * reach / (REACH * height)  # what `fall` changes by with the distance

    level = [dot(corner - floor.p, floor.n).abs() <= 2.0 * floor.clearance for corner in corners]
    along = [floor.plain & level[1] & level[2], floor.plain & level[2] & level[0], floor.plain & level[0] & level[1]]
    farther_u, farther_v = dot(e1, near.d), dot(e2, near.d)  # what the distance changes by
    rises = [rise_from(weight * over, (over * by_u, over * by_v), (farther_u, farther_v), near.distance, touches)
             for weight, over, touches, by_u, by_v in zip((1.0 - near.u - near.v, near.u, near.v), heights, along,
                                                          (-1.0, 1.0, 0.0), (-1.0, 0.0, 1.0))]
    (s0, *t0), (s1, *t1), (s2, *t2) = rises
    rise, counts = s0 * s1 * s2, (near.plain & seen).to(left.dtype)
    by_u, by_v = (counts * (steep * farther * rise + left * left * (a * s1 * s2 + b * s0 * s2 + c * s0 * s1))
                  for farther, a, b, c in zip((farther_u, farther_v), t0, t1, t2))
    return Slide(fall * rise, by_u, by_v)


def rise_from(over: Tensor, pace: tuple[Tensor, Tensor], farther: tuple[Tensor, Tensor], distance: Tensor,
              touches: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """A smooth rise from 0 at an edge to 1, and its derivatives by u and v; 1 where the edge `touches` the surface of x.

    Args:
        over: how far from the edge the points lie; `pace`: its derivatives by u and v.
        distance: of x; `farther`: its derivatives.
        touches: bool.
    """
    width = BORDER * distance.clamp_min(TINY)
    way = (over / width).clamp(0.0, 1.0)
    slope = torch.where(touches, 0.0, 6.0 * way * (1.0 - way) / width)
    return (torch.where(touches, 1.0, way * way * (3.0 - 2.0 * way)),
            *(slope * (own - way * BORDER * away) for own, away in zip(pace, farther)))
