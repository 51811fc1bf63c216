"""Intersections of bodies: the segments along which triangles of two bodies meet or touch.

A body is a shape, or a shape of a group as one instance shows it. Of two bodies whose boxes overlap the triangles are looked
at that reach into the box of the other, and of these the pairs whose boxes overlap along one axis, found by sorting. How a
surface passes through itself is not looked at. What touching edges mean is said in `contacts.py`.

Reference: Moeller 1997, "A Fast Triangle-Triangle Intersection Test".
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.curve.faces import Faces
from torch_radbp.boundary.curve.geometry import Corners, Geometry
from torch_radbp.boundary.curve.segments import Segments, height_above, zero_crossings
from torch_radbp.tensors.record import joined
from torch_radbp.tensors.stage import Stages, stage
from torch_radbp.tensors.vec import Vec2, Vec3, cross, dot, interpolated, rows

MOST = 1 << 21  # pairs of triangles, or of bodies, that are looked at together
TOUCHING = 1e-6  # of the largest coordinate, by which triangles must reach beyond each other


class Boxes(NamedTuple):
    """N axis-aligned boxes by their corners; world, (N,) each."""

    low: Vec3
    high: Vec3

    def overlap(self, others: Boxes) -> Tensor:
        """(N,) bool: boxes that overlap the corresponding boxes of others."""
        found = None
        for low, high, other_low, other_high in zip(self.low, self.high, others.low, others.high):
            both = (low <= other_high) & (other_low <= high)
            found = both if found is None else found & both
        return found


@stage("geometry")
def boxes_around(geometry: Geometry, faces: Faces) -> Boxes:
    """The bounding boxes of triangles, (F,) world; float64."""
    corners = faces.corners(geometry)
    return Boxes(*(Vec3(*(extreme(extreme(a, b), c) for a, b, c in zip(*corners)))
                   for extreme in (torch.minimum, torch.maximum)))


class Pairs(NamedTuple):
    """N pairs of row indices, (N,) int64 each."""

    one: Tensor
    other: Tensor


class Bodies(NamedTuple):
    """The triangles of all bodies, sorted by body."""

    faces: Faces  # (F,)
    sizes: Tensor  # (B,) int64, number of triangles of each
    moves: Tensor  # (B,) bool: it moves; only pairs with a moving body are examined


class Met(NamedTuple):
    """The segments along which bodies intersect, and those along which they touch; None: there are none."""

    segments: Segments | None  # along which they pass through each other
    touching: Segments | None  # parts of sides of triangles that lie on other triangles


def intersections(stages: Stages, geometry: Geometry, bodies: Bodies) -> Met:
    """Finds the segments along which bodies intersect or touch. `geometry`: of the scene, detached."""
    faces, sizes, moves = bodies
    boxes = stages(boxes_around)(geometry, faces)
    around = boxes_of_bodies(boxes, sizes)
    pairs = meeting(around, moves)
    if not len(pairs.one):
        return Met(None, None)
    first = sizes.cumsum(0) - sizes
    reach = [_reaching(boxes, around, first, sizes, own, other) for own, other in (pairs, pairs[::-1])]
    segments, touching = [], []
    for own in _candidates(boxes, *reach, len(pairs.one)):
        planes = planes_of(geometry, faces, own)
        segments.append(segments_on(planes))
        touching += [sides_on(planes), sides_on(planes.turned())]
    return Met(*(joined(kept) if kept else None
                 for kept in ([part for part in parts if len(part.triangle)] for parts in (segments, touching))))


def boxes_of_bodies(boxes: Boxes, sizes: Tensor) -> Boxes:
    """The bounding boxes of bodies, from those of their triangles; empty for a body without triangles."""
    def extreme(way: str, none: float, columns: Vec3) -> Vec3:
        return Vec3(*(torch.segment_reduce(column, way, lengths=sizes, initial=none) for column in columns))

    return Boxes(extreme("min", torch.inf, boxes.low), extreme("max", -torch.inf, boxes.high))


def meeting(bodies: Boxes, moves: Tensor) -> Pairs:
    """The pairs of bodies whose boxes overlap and of which one moves."""
    found, count = [], len(moves)
    for own in torch.arange(count, device=moves.device).split(max(1, MOST // max(count, 1))):
        meet = rows(bodies, own)
        meet = Boxes(*(corner.map(lambda column: column[:, None]) for corner in meet)).overlap(bodies)
        one, other = (meet & (rows(moves, own)[:, None] | moves)).nonzero().unbind(1)
        one = own[one]
        found.append(Pairs(one[one < other], other[one < other]))
    return joined(found)


def _expanded(counts: Tensor) -> tuple[Tensor, Tensor]:
    """For counts, (N,) int64, one entry per counted item: the index of its owner, and its number within the owner."""
    which = torch.repeat_interleave(counts)
    return which, torch.arange(len(which), device=which.device) - (counts.cumsum(0) - counts)[which]


def _reaching(boxes: Boxes, bodies: Boxes, first: Tensor, sizes: Tensor, own: Tensor, other: Tensor) -> Pairs:
    """The triangles that reach into the box of the other body of a pair, as pairs of (pair of bodies, triangle).

    Args:
        boxes: of all triangles.
        bodies: the boxes of all bodies.
        first, sizes: (B,) the first triangle of each body, and how many it has.
        own, other: (P,) the two bodies of each pair.
    """
    found, size = [], sizes[own]
    for part in torch.arange(len(own), device=own.device).split(_parts_of(size)):
        pair, place = _expanded(size[part])
        pair = part[pair]
        triangle = first[own[pair]] + place
        inside = rows(boxes, triangle).overlap(rows(bodies, other[pair]))
        found.append(Pairs(pair[inside], triangle[inside]))
    return joined(found)


def _candidates(boxes: Boxes, ones: Pairs, others: Pairs, count: int) -> Iterator[Pairs]:
    """Yields pairs of triangles with overlapping boxes, in parts of bounded size.

    Args:
        boxes: of all triangles.
        ones, others: for each of `count` pairs of bodies, the triangles of either that reach into the box of the other.
    """
    low, high = boxes.low.x, boxes.high.x
    start = min(float(low[own.other].min()) if len(own.other) else torch.inf for own in (ones, others))
    end = max(float(high[own.other].max()) if len(own.other) else -torch.inf for own in (ones, others))
    if not start < torch.inf:
        return
    width = 2.0 * (end - start) + 1.0  # pairs of bodies lie apart on one axis

    def on_axis(own: Pairs, values: Tensor) -> Tensor:
        return values[own.other] - start + width * own.one

    lows = on_axis(others, low)
    order = lows.argsort(stable=True)
    lows, widest = lows[order], on_axis(others, high)[order].cummax(0).values if len(order) else lows
    begin = torch.searchsorted(widest, on_axis(ones, low))
    count = (torch.searchsorted(lows, on_axis(ones, high), right=True) - begin).clamp_min(0)
    for own in torch.arange(len(count), device=count.device).split(_parts_of(count)):
        which, place = _expanded(count[own])
        one, other = ones.other[own[which]], others.other[order[begin[own[which]] + place]]
        meet = rows(boxes, one).overlap(rows(boxes, other))
        yield Pairs(one[meet], other[meet])


def _parts_of(counts: Tensor) -> list[int]:
    """Divides items with counts, (N,) int64, into parts of bounded total count; returns the numbers of items."""
    return torch.bincount(torch.div(counts.cumsum(0) - counts, MOST, rounding_mode="floor")).tolist()


class Planes(NamedTuple):
    """N pairs of triangles, with the heights of the corners of each above the plane of the other."""

    faces: tuple[Faces, Faces]
    corners: tuple[Corners, Corners]
    heights: tuple[Heights, Heights]  # of either triangle's corners above the other's plane

    def turned(self) -> Planes:
        """The same pairs with the two triangles exchanged."""
        return Planes(*(part[::-1] for part in self))


class Heights(NamedTuple):
    """The heights of the corners of N triangles above planes."""

    height: tuple[Tensor, Tensor, Tensor]  # (N,) of any unit
    least: Tensor  # (N,) height below which a corner counts as in the plane, same unit
    crosses: Tensor  # (N,) bool: corners lie on both sides, by more than that


def planes_of(geometry: Geometry, faces: Faces, pairs: Pairs) -> Planes:
    """The heights of the corners of each triangle of pairs, given by row, above the plane of the other one."""
    both = rows(faces, pairs.one), rows(faces, pairs.other)
    corners = both[0].corners(geometry), both[1].corners(geometry)
    scale = TOUCHING * torch.stack([column.abs() for corner in corners[0] for column in corner]).amax(0)
    return Planes(both, corners, tuple(heights_above(corners[1 - way], corners[way], scale) for way in (0, 1)))


def segments_between(geometry: Geometry, faces: Faces, pairs: Pairs) -> Segments:
    """The segments along which pairs of triangles, given by row, intersect, each on the first triangle of its pair."""
    return segments_on(planes_of(geometry, faces, pairs))


def segments_on(planes: Planes) -> Segments:
    """The segments along which the pairs of triangles in `planes` intersect, each on the first triangle of its pair."""
    meet = planes.heights[0].crosses & planes.heights[1].crosses
    planes = rows(planes, meet.nonzero().squeeze(1))
    return _segments_along(planes, tuple(own.height for own in planes.heights))


def sides_on(planes: Planes) -> Segments:
    """The parts of the first triangle's sides that lie on the second triangle, while its third corner does not.

    The second triangle reaches to both sides of the plane of the first one, or ends there.
    """
    (side, other) = planes.heights
    on = [height.abs() <= side.least for height in side.height]
    rests = (on[0].int() + on[1] + on[2] == 2) & (other.crosses | (
        sum((height.abs() <= other.least).int() for height in other.height) == 2))
    planes = rows(planes, rests.nonzero().squeeze(1))
    heights = []
    for own in planes.heights:
        # Exactly 0 in the plane, and the corner that is alone above it.
        level = [torch.where(height.abs() <= own.least, 0.0, height) for height in own.height]
        below = ~own.crosses & (level[0] + level[1] + level[2] < 0.0)
        heights.append(tuple(torch.where(below, -height, height) for height in level))
    return _segments_along(planes, tuple(heights))


def _segments_along(planes: Planes, heights: tuple[tuple[Tensor, Tensor, Tensor], ...]) -> Segments:
    """The segments that both triangles of each pair share, on the first triangle.

    Args:
        planes: (N,) the pairs.
        heights: of the corners of either triangle above the plane of the other, (N,) each; 0 on the segment.
    """
    (one, other), corners, _ = planes
    ends = [zero_crossings(*own) for own in heights]  # on the first triangle, on the second one
    points = [[interpolated(own, end.x, end.y) for end in both] for own, both in zip(corners, ends)]
    along = points[0][1] - points[0][0]
    length = dot(along, along)
    shares = [dot(point - points[0][0], along) / length for point in points[1]]
    enters, leaves = torch.minimum(*shares).clamp_min(0.0), torch.maximum(*shares).clamp_max(1.0)
    a, run = ends[0][0], ends[0][1] + ends[0][0] * -1.0
    none = Vec2(*(torch.zeros_like(enters),) * 2)
    found = Segments(one.triangle, one.instance, a + run * enters, a + run * leaves, none, none,
                     torch.full_like(one.triangle, -1), other.triangle, other.instance, one.share)
    return rows(found, (enters < leaves).nonzero().squeeze(1))


def heights_above(plane: Corners, corners: Corners, least: Tensor) -> Heights:
    """The heights of triangles' corners above the planes of other triangles.

    Args:
        plane: the corners of the other triangles.
        corners: the corners whose heights are computed.
        least: (N,) the distance from a plane below which a corner touches it.
    """
    normal = cross(plane[1] - plane[0], plane[2] - plane[0])
    least = least * torch.sqrt(dot(normal, normal))
    height = tuple(height_above(plane, corner) for corner in corners)
    low, high = torch.minimum(torch.minimum(*height[:2]), height[2]), torch.maximum(torch.maximum(*height[:2]), height[2])
    return Heights(height, least, (low < -least) & (high > least))
