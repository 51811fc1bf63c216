"""How a path's next vertex moves where it lies close to the last one.

A vertex y that is glued to its triangle is seen from the last vertex x in a direction that turns by (y' - x') / r. Where
surfaces meet that move apart, or x slides over one of them, samples of a derivative are then as large as 1 / r, and their
variance is infinite. So a vertex that is near lets go of its triangle: it slides over it by a share m of the way by which it
would stay in the fixed direction from x. With G the turning of the direction to the glued vertex, directions turn by

    V = (1 - m) G,    div V = (1 - m) div G - grad m . G

over solid angle, the second of which is the change of the element of solid angle. As a function of y's barycentric
coordinates (u, v), which change by (u', v') in a fixed direction, it is (1 - m) div G + m_u u' + m_v v'.

Any m may be chosen that is continuous over a triangle and 0 along its edges: then no edge and no other surface sees anything
of it, and only borders that lie inside of triangles move differently over points that slide (`boundary/eye/slid.py`).

Where x rises from the triangle's plane, h above it, points in fixed directions move away from its foot by rho / h, with rho
their distance from there; what m changes by on this way counts as often as directions of that rho are met, h / rho^2. So the
variance is that of m', squared and integrated over rho, over h: least where m falls linearly. Here it falls from x's foot to
the edges, or to the end of a reach, whichever comes first,

    m = D / (D + h) min(lambda_i(y) / lambda_i(foot), 1 - rho / sqrt(R^2 - h^2))

with lambda_i the barycentric coordinates, D the least distance of the foot from where m is 0, and R a share of the least
height of the triangle. No direction turns by more than 2 / (D + h), and no element of solid angle changes by more than 1 / h
for what x moves, where glued points have 1 / r and its square. Where the foot lies outside, points stay glued.

Edges in the plane of x, along which surfaces touch, need no m of 0: light along that plane does not count.
Triangles at which light jumps for other reasons than shadows are *not plain*, and vertices stay glued to them.

Reference: Zhang et al. 2020, "Path-Space Differentiable Rendering", section 4 (any continuous motion of the points serves);
Bangaru, Li and Durand 2020, "Unbiased Warped-Area Sampling for Differentiable Rendering" (fields that follow edges).
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.scene.tables.triangle_corners import Corners
from torch_radbp.tensors.vec import TINY, Vec3, cross, dot

REACH = 0.5  # of the least height of a triangle: how near x must be


class Slide(NamedTuple):
    """How far vertices slide over their triangles when the previous vertex moves, (N,); detached."""

    share: Tensor  # m, the share of sliding; 0: glued to the triangle
    by_u: Tensor  # how that changes with the barycentric coordinate of the second vertex
    by_v: Tensor  # and of the third


class Nearby(NamedTuple):
    """Points on triangles as seen from a previous vertex x close by, (N,); detached."""

    corners: Corners  # of the triangle, world
    u: Tensor  # barycentric coordinates: of the second vertex
    v: Tensor  # of the third
    d: Vec3  # unit, from x to the point
    distance: Tensor
    plain: Tensor  # bool: the triangle's material is plain, see `TriangleTable.plain`


class Floor(NamedTuple):
    """The surfaces on which the previous vertices x lie, (N,); detached."""

    p: Vec3  # x
    n: Vec3  # unit normal
    plain: Tensor  # bool: its material is plain, so that light along its plane does not count
    clearance: Tensor  # by which points in its plane may seem to lie off it


def heights_of(corners: Corners) -> tuple[Tensor, Tensor, Tensor]:
    """The three altitudes of triangles, (N,) each; detached."""
    p0, p1, p2 = (corner.detach() for corner in corners)
    e1, e2 = p1 - p0, p2 - p0
    n, across = cross(e1, e2), e2 - e1
    size = torch.sqrt(dot(n, n))
    return tuple(size * torch.rsqrt(dot(edge, edge).clamp_min(TINY)) for edge in (across, e2, e1))


def slides_from(corners: Corners, distance: Tensor, plain: Tensor) -> Tensor:
    """(N,) bool: points on triangles are so close to the previous vertex that they may slide. Args as of `Nearby`."""
    return plain & (distance < REACH * least(heights_of(corners)))


def least(heights: tuple[Tensor, Tensor, Tensor]) -> Tensor:
    return torch.minimum(torch.minimum(heights[0], heights[1]), heights[2])


def slide_at(near: Nearby, floor: Floor) -> Slide:
    """How far points near the previous vertex x slide over their triangles when x moves, (N,)."""
    p0, p1, p2 = corners = tuple(corner.detach() for corner in near.corners)
    e1, e2, heights = p1 - p0, p2 - p0, heights_of(corners)
    n, gap = cross(e1, e2), floor.p - p0
    squared = dot(n, n).clamp_min(TINY)
    foot_u, foot_v = dot(cross(gap, e2), n) / squared, dot(cross(e1, gap), n) / squared
    above, reach = dot(gap, n).abs() * torch.rsqrt(squared), REACH * least(heights)
    slides = near.plain & (dot(n, near.d).abs() > TINY) & (above < reach)

    radius = torch.sqrt((reach * reach - above * above).clamp_min(TINY))
    away = e1 * (near.u - foot_u) + e2 * (near.v - foot_v)
    distance = torch.sqrt(dot(away, away)).clamp_min(TINY)
    share, nearest = 1.0 - distance / radius, radius
    by_u, by_v = (-dot(away, edge) / (distance * radius) for edge in (e1, e2))

    level = [dot(corner - floor.p, floor.n).abs() <= 2.0 * floor.clearance for corner in corners]
    ends = ((1.0 - foot_u - foot_v, 1.0 - near.u - near.v, -1.0, -1.0), (foot_u, near.u, 1.0, 0.0),
            (foot_v, near.v, 0.0, 1.0))
    for number, ((of_foot, here, u, v), height) in enumerate(zip(ends, heights)):
        counts = ~(floor.plain & level[number - 1] & level[number - 2])
        slides = slides & ((of_foot > TINY) | ~counts)
        of_foot = of_foot.clamp_min(TINY)
        nearest = torch.where(counts, torch.minimum(nearest, of_foot * height), nearest)
        first = counts & (here < share * of_foot)
        share, by_u, by_v = (torch.where(first, at_foot / of_foot, other)
                             for at_foot, other in ((here, share), (u, by_u), (v, by_v)))
    size = torch.where(slides & (share > 0.0), nearest / (nearest + above).clamp_min(TINY), 0.0)
    return Slide(size * share, size * by_u, size * by_v)
