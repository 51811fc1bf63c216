"""Straight discontinuity curves inside of triangles (texture lines, intersections), and the levels by which they move.

They are lines at which textures jump, and lines along which other triangles pass through. Both lie on a triangle as a
segment with fixed barycentric coordinates. Where a *level* changes at a fixed place by df, the line moves as `contour.py`
derives: the level is the height above the plane of a triangle that passes through, or the number that is an integer on lines
of a texture. So these move with their triangle, and slide over it where the surface coordinates change.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.curve.faces import with_shares
from torch_radbp.boundary.curve.geometry import Between, Corners, Geometry, largest_coordinate, positions
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.record import joined as joined_records
from torch_radbp.tensors.vec import Vec2, Vec3, cross, dot, unit_normal

IN_PLANE = 1e-6  # share of the largest coordinate up to which viewers lie in a plane


class SeenFrom(NamedTuple):
    """The sides of the triangles from which S segments are visible; float64 but for the last."""

    side: Tensor  # of the segment's triangle: 1, -1; 0: both
    side_of_through: Tensor  # of the intersecting triangle, likewise
    rests: Tensor  # (S,) bool: an edge lies on the surface there, without passing through


class Segments(NamedTuple):
    """S straight discontinuity curves inside of triangles, as stages read them; barycentric (u, v), float64."""

    triangle: Tensor  # (S,) int32
    instance: Tensor | None  # (S,) int32 instance as in a hit; None: the scene has none
    start: Vec2  # (S,)
    end: Vec2  # (S,)
    aside: Vec2  # (S,) a step across, after which a place lies surely on one side; 0: it is not known
    rise: Vec2  # (S,) of lines of textures what their number changes by with u and v, else 0
    line: Tensor  # (S,) int32, which line it is of, see `term.LineNumbers`; -1 of where a triangle passes through
    through: Tensor  # (S,) int32, the triangle that passes through there; -1: none does, a texture jumps
    shown_by: Tensor | None  # (S,) int32, the instance that shows that
    share: Tensor | None  # (S,) float64, how often a segment is among these, in the mean; None: once
    seen_from: SeenFrom | None = None  # None: each from everywhere

    def corners(self, geometry: Geometry) -> Corners:
        """The corner positions of the segments' triangles, world, float64."""
        return positions(geometry, Between(*lookup(geometry.triangles.corners, self.triangle)), self.instance)


def joined_segments(parts: list[Segments]) -> Segments | None:
    """Joins several sets of segments into one; None: there are none."""
    if len(parts) > 1 and any(part.seen_from is not None for part in parts):
        parts = [part if part.seen_from is not None else part._replace(seen_from=from_everywhere(part)) for part in parts]
    return joined_records(with_shares(parts)) if parts else None


def from_everywhere(segments: Segments) -> SeenFrom:
    """The sides from which segments are visible, for segments that are visible from all."""
    none = torch.zeros_like(segments.start.x)
    return SeenFrom(none, none, torch.zeros_like(none, dtype=torch.bool))


def faces_viewer(geometry: Geometry, segments: Segments, corners: Corners, towards: Callable[[Vec3], Vec3]) -> Tensor:
    """(N,) bool: segments on triangle sides that face the viewer; False if the viewer lies in the plane, up to rounding.

    Args:
        geometry: of the scene, detached.
        segments: (N,) the segments.
        corners: the corners of their triangles.
        towards: returns the directions from (N,) points to the viewer, of any length.
    """
    seen = None
    planes = corners, place_of(geometry, segments.through, segments.shown_by)
    for plane, side in zip(planes, segments.seen_from[:2]):
        normal, d = unit_normal(plane[1] - plane[0], plane[2] - plane[0]), towards(plane[0])
        least = IN_PLANE * largest_coordinate(d, *plane)
        here = (side == 0.0) | (side * dot(normal, d) > least)
        seen = here if seen is None else seen & here
    return seen


def place_of(geometry: Geometry, triangle: Tensor, instance: Tensor | None) -> Corners:
    """The corner positions of triangles, (N,) int32, in the world, attached; those of any triangle for -1."""
    return positions(geometry, Between(*lookup(geometry.triangles.corners, triangle.clamp_min(0))), instance)


def height_above(corners: Corners, p: Vec3) -> Tensor:
    """The heights of points above the planes of triangles, times twice the triangles' areas; (N,) attached."""
    return dot(cross(corners[1] - corners[0], corners[2] - corners[0]), p - corners[0])


def heights_by(passed: Corners, corners: Corners) -> Vec2:
    """The derivatives, by u and v on triangles, of the height above the planes of intersecting triangles; (N,)."""
    upright = cross(passed[1] - passed[0], passed[2] - passed[0])
    return Vec2(*(dot(upright, corner - corners[0]) for corner in corners[1:]))


def level_on_lines(geometry: Geometry, between: Between, u: Tensor, v: Tensor, line: Tensor) -> Tensor:
    """The value that is an integer on texture lines, up to a constant, (N,) attached: the level function of these lines.

    Args:
        between: the vertices of triangles, on which u and v are barycentric coordinates.
        line: (N,) int32, rows of `LineNumbers`.
    """
    x = y = None
    if geometry.triangles.vertices.uv is not None:
        uv = [lookup(geometry.triangles.vertices.uv, row) for row in between]
        x, y = (sum(getattr(corner, axis).double() * weight for corner, weight in zip(uv, (1.0 - u - v, u, v)))
                for axis in ("x", "y"))
    return geometry.lines.level(line.clamp_min(0), x, y)


def zero_crossings(f0: Tensor, f1: Tensor, f2: Tensor) -> tuple[Vec2, Vec2]:
    """The two points on the sides of triangles where a linear function, given at the corners, vanishes; barycentric.

    The two coincide if the function is 0 at one corner only, or nowhere.
    """
    at_1, at_2 = (f0 > 0.0) == (f2 > 0.0), (f0 > 0.0) == (f1 > 0.0)  # the corner that is alone on its side
    at_2 = at_2 & ~at_1
    ends = []
    for other in (1, 2):
        # From the corner that is alone to the one that comes so many places after it.
        alone = torch.where(at_1, f1, torch.where(at_2, f2, f0))
        beyond = torch.where(at_1, (f0, f1, f2)[(1 + other) % 3], torch.where(at_2, (f0, f1, f2)[(2 + other) % 3],
                                                                             (f1, f2)[other - 1]))
        share = (alone / torch.where(alone == beyond, 1.0, alone - beyond)).clamp(0.0, 1.0)
        weight = [torch.zeros_like(share) for _ in range(3)]
        for apex, here in ((0, ~(at_1 | at_2)), (1, at_1), (2, at_2)):
            weight[apex] = torch.where(here, 1.0 - share, weight[apex])
            to = (apex + other) % 3
            weight[to] = torch.where(here, share, weight[to])
        ends.append(Vec2(weight[1], weight[2]))
    return ends[0], ends[1]
