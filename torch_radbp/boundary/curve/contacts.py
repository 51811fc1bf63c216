"""Contacts: edges of one body that lie on the surface of another.

A cube stands on a floor. Its lower edge is a silhouette for a camera and for a lamp at once: the border of the cube and that
of its shadow are one line. If the cube rises, a strip of floor comes into view of which a part lies in the shade; if it
sinks, its side meets the floor along a line that stays where it is. So the image has two one-sided derivatives, each linear
in the velocities, and the one returned is their mean: it lies between them whatever moves, and however pixels are weighted.
By one half, bodies sink into each other: where an edge lies on another surface it is hidden, and the triangles at the edge
pass through that surface along a segment, which moves as all segments do (`segments.py`). By the other half they part: the
edge is a silhouette, and what its shadow does then is counted in `terms/under_edges.py`. Where bodies slide along each
other, both are equal.

Of an edge at which two triangles meet, each passes through the surface on the side on which the other one does not lie, and
is seen from there alone. Where the two lie on either side of the surface, the body passes through it, and the edge does not
count at all. Where an edge lies right on an edge of what it touches, that has to go on beyond; where it does not, as between
bodies that are flush, both edges are as visible as any. Edges at which more than two triangles meet are left as they are.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.curve.edges import Edges
from torch_radbp.boundary.curve.geometry import Geometry, in_world
from torch_radbp.boundary.curve.intersections import TOUCHING
from torch_radbp.boundary.curve.junctions import OBLIQUE
from torch_radbp.boundary.curve.pierced import shape_of
from torch_radbp.boundary.curve.segments import SeenFrom, Segments, height_above, place_of
from torch_radbp.tensors.record import joined
from torch_radbp.tensors.vec import TINY, Vec3, cross, dot, interpolated, rows

SAME = 1e-5  # of the largest coordinate, up to which middles of parts of an edge are one
AT_SIDE = 1e-6  # barycentric coordinate up to which a segment lies on a side of its triangle
GAP = 1e-5  # share of an edge's length between parts that touch something, up to which they are one


class Resting(NamedTuple):
    """K parts of edges that lie on surfaces of other bodies, as a cube's lower edges on a floor."""

    corner: Tensor  # (K,) int32, index of the corner opposite the edge in one of its triangles
    instance: Tensor | None  # (K,) int32, its instance as in a hit; None: the scene has none
    start: Vec3  # (K,) where the part begins, world, float64
    end: Vec3
    counts: Tensor  # (K,) float64, weight of the edge there: a half, or 0 if it passes through


class Contacts(NamedTuple):
    """Where bodies touch: segments on triangles, and parts of edges."""

    segments: Segments  # along which triangles at edges pass through what these lie on
    resting: Resting


def contacts_of(geometry: Geometry, touching: Segments, ends: Tensor,
                edges_of_shape: Callable[[int], Edges]) -> Contacts | None:
    """Finds the contacts of bodies, from the triangle sides that lie on other triangles; None: there are none.

    Args:
        geometry: of the scene, detached.
        touching: the triangle sides that lie on other triangles.
        ends: (S,) int64, the end of each shape's triangles among all.
        edges_of_shape: the edges of one shape, by its number.
    """
    number = opposite_corner(touching)
    corner, key = 3 * touching.triangle + number, keys_of(3 * touching.triangle + number, touching.instance)
    count, tip = across_edges(corner, shape_of(ends, touching.triangle), edges_of_shape)
    mine, passed = (place_of(geometry, *surface) for surface in ((touching.triangle, touching.instance),
                                                                 (touching.through, touching.shown_by)))
    beyond, = in_world(geometry, (tip.clamp_min(0),), touching.instance)
    # Where the triangles at the edge lie, above or below the surface, and the second one, before or behind the first.
    above, closed = _side_of(passed, [rows_of_corner(mine, number)]), count == 2
    of_second, folds = (torch.where(closed, _side_of(plane, [beyond]), 0.0) for plane in (passed, mine))
    pierces = of_second * above < 0.0
    facing = torch.where(pierces, 0.0, -folds)
    counts = (count == 1) | (closed & (pierces | (folds != 0.0)))
    # Where the surface has an edge there, too, it must go on beyond.
    start, end = (interpolated(mine, place.x, place.y) for place in (touching.start, touching.end))
    reach = _side_of(mine, passed)
    meets_edge = ~pierces & (reach == torch.where(closed, facing, 1.0)) & has_other_side(key, start + end, reach)
    kept = (counts & ((reach == 0.0) | meets_edge)).nonzero().squeeze(1)
    if not len(kept):
        return None
    once = torch.ones_like(reach) if touching.share is None else touching.share
    segments = touching._replace(seen_from=SeenFrom(facing, above, ~pierces), share=torch.where(pierces, once, 2.0 * once))
    return Contacts(*rows((segments, Resting(corner, touching.instance, start, end, 0.5 - 0.5 * pierces.double())), kept))


def across_edges(corner: Tensor, shape: Tensor, edges_of_shape: Callable[[int], Edges]) -> tuple[Tensor, Tensor]:
    """The number of triangles at each edge, and the vertex opposite it in the second, (K,) int32 each; -1: no second.

    Args:
        corner: (K,) int32, indices of the corners opposite the edges.
        shape: (K,) the shapes of these.
        edges_of_shape: the edges of one shape, by its number.
    """
    count, tip = torch.zeros_like(corner), torch.full_like(corner, -1)
    for number in shape.unique().tolist():
        edges, own = edges_of_shape(number), (shape == number).nonzero().squeeze(1)
        wanted, place = corner[own].unique(return_inverse=True)
        of_wanted = torch.zeros_like(wanted), torch.full_like(wanted, -1)
        for column, beyond in zip(edges.corner[:2], edges.opposite[1::-1]):
            row, which = rows_at(column, wanted)
            of_wanted[0][which], of_wanted[1][which] = edges.count[row], beyond[row]
        count[own], tip[own] = (column[place] for column in of_wanted)
    return count, tip


def resting_among(segments: Segments) -> Segments | None:
    """Selects the segments along which edges lie on surfaces without passing through; None: there are none."""
    if segments.seen_from is None:
        return None
    return rows(segments, segments.seen_from.rests.nonzero().squeeze(1))


def keys_of(corner: Tensor, instance: Tensor | None) -> Tensor:
    """(N,) int64 keys that are equal for equal pairs of a corner, (N,) int32, and an instance."""
    return corner.long() if instance is None else corner.long() * (1 << 31) + instance


def has_other_side(key: Tensor, place: Vec3, reach: Tensor) -> Tensor:
    """(N,) bool: parts of edges both of whose triangles touch a surface, on opposite sides.

    Args:
        key: (N,) of the edges.
        place: (N,) the middles of the parts, world.
        reach: (N,) the side of the triangle at the edge on which the touched surface lies: 1, -1.
    """
    height = place.x * OBLIQUE[0] + place.y * OBLIQUE[1] + place.z * OBLIQUE[2]
    order = height.argsort(stable=True)
    order = order[key[order].argsort(stable=True)]
    key, height, reach = key[order], height[order], reach[order]
    near = SAME * height.abs().max() if len(height) else 0.0
    pair = (key[1:] == key[:-1]) & (reach[1:] == -reach[:-1]) & (height[1:] - height[:-1] <= near)
    both = torch.zeros_like(key, dtype=torch.bool)
    both[order[1:]] |= pair
    both[order[:-1]] |= pair
    return both


def opposite_corner(segments: Segments) -> Tensor:
    """(S,) int32, 0 to 2: for segments on a side of their triangle, the corner opposite that side."""
    (u, v), (s, t) = segments.start, segments.end
    first, second = (torch.maximum(*both) <= AT_SIDE for both in ((1.0 - u - v, 1.0 - s - t), (u, s)))
    return torch.where(first, 0, torch.where(second, 1, 2)).to(torch.int32)


def rows_of_corner(corners: tuple[Vec3, Vec3, Vec3], number: Tensor) -> Vec3:
    """For each lane the corner of the given number, (N,) int32, 0 to 2, out of three."""
    return Vec3(*(torch.where(number == 0, a, torch.where(number == 1, b, c)) for a, b, c in zip(*corners)))


def _side_of(plane: tuple[Vec3, Vec3, Vec3], points: tuple[Vec3, ...] | list[Vec3]) -> Tensor:
    """The side of triangles' planes on which all points lie, (N,) float64: 1, -1, or 0 in the plane or on both sides."""
    normal = cross(plane[1] - plane[0], plane[2] - plane[0])
    scale = torch.stack([part.abs() for point in (*plane, *points) for part in point]).amax(0)
    least = TOUCHING * scale * torch.sqrt(dot(normal, normal))
    heights = torch.stack([height_above(plane, point) for point in points])
    up, down = (heights > least).any(0), (heights < -least).any(0)
    return up.double() - down.double()


def rows_at(column: Tensor, wanted: Tensor) -> tuple[Tensor, Tensor]:
    """The rows of a column at which sorted wanted numbers, (W,), occur, (K,) int64, and which number each is."""
    which = torch.searchsorted(wanted, column).clamp_max(len(wanted) - 1)
    row = (wanted[which] == column).nonzero().squeeze(1)
    return row, which[row]


class EdgeParts(NamedTuple):
    """P parts of edges, given by their start and end as shares of the edge, (P,) float64."""

    start: Tensor  # shares of the edges' lengths
    end: Tensor
    counts: Tensor  # weight of the part, less than 1 where it lies on another body's surface

    def weight(self, along: Tensor) -> Tensor:
        """The weight of points on edges, given by their share of the length, (P,); 0 outside of the parts."""
        return torch.where((along >= self.start) & (along <= self.end), self.counts, 0.0)


def parts_of_edges(a: Vec3, b: Vec3, resting: Resting, edge: Tensor) -> tuple[Tensor, EdgeParts]:
    """Divides edges into the parts that lie on a surface and those that do not.

    Args:
        a, b: (K,) the ends of edges, world.
        resting: (K,) the parts that lie on a surface.
        edge: (K,) int64, the number of the edge of each; it may occur several times.

    Returns:
        (P,) int64, the number of the edge of each part, and the parts.
    """
    along = b - a
    length = dot(along, along).clamp_min(TINY)
    shares = torch.stack([dot(point - a, along) / length for point in (resting.start, resting.end)]).clamp(0.0, 1.0)
    every = edge.unique()
    # One after the other on a line, each edge with its ends as parts that cover nothing.
    low = torch.cat([shares.amin(0) + 2.0 * edge, 2.0 * every, 2.0 * every + 1.0])
    high = torch.cat([shares.amax(0) + 2.0 * edge, 2.0 * every, 2.0 * every + 1.0])
    order = low.argsort(stable=True)
    reached, begins = high[order].cummax(0).values[:-1], low[order][1:]
    which = torch.div(begins, 2.0, rounding_mode="floor")
    free = ((begins - reached > GAP) & (reached >= 2.0 * which)).nonzero().squeeze(1)
    which, reached, begins = which[free], reached[free], begins[free]
    # What lies on something begins where what lies on nothing ends, or the edge does.
    points = torch.cat([2.0 * every, 2.0 * every + 1.0, reached, begins]).sort().values
    covers = points[1:] - points[:-1] > GAP
    covers &= torch.div(points[1:], 2.0, rounding_mode="floor") == torch.div(points[:-1], 2.0, rounding_mode="floor")
    low, high = points[:-1][covers], points[1:][covers]
    of_part = torch.div(low, 2.0, rounding_mode="floor")
    least = torch.ones_like(a.x).scatter_reduce(0, torch.searchsorted(every, edge), resting.counts, "amin")
    counts = torch.where(torch.isin(low, reached), 1.0, least[torch.searchsorted(every, of_part.long())])
    return of_part.long(), EdgeParts(low - 2.0 * of_part, high - 2.0 * of_part, counts)


def edges_in_parts(geometry: Geometry, edges: Edges, instance: Tensor | None,
                   resting: Resting) -> tuple[Tensor, EdgeParts] | None:
    """Divides edges where parts of them lie on other surfaces; None: there are no such parts.

    Args:
        geometry: of the scene, detached.
        edges: E edges.
        instance: (E,) int32, the instance of each; None: the scene has none.
        resting: the parts of edges that lie on surfaces.

    Returns:
        (P,) int64, the row of the edge of each part, where rows may occur several times; and the parts.
    """
    wanted, place = keys_of(resting.corner, resting.instance).unique(return_inverse=True)
    edge = torch.full_like(wanted, -1)
    for column in edges.corner:
        row, which = rows_at(keys_of(column, instance), wanted)
        edge[which] = row
    edge = edge[place]
    there = (edge >= 0).nonzero().squeeze(1)
    if not len(there):
        return None
    edge, resting = edge[there], rows(resting, there)
    a, b = in_world(geometry, (rows(edges.a, edge), rows(edges.b, edge)), rows(instance, edge))
    part, parts = parts_of_edges(a, b, resting, edge)
    whole = torch.ones_like(edges.a, dtype=torch.bool).index_fill(0, edge, False).nonzero().squeeze(1)
    none = torch.zeros_like(whole, dtype=torch.float64)
    return torch.cat([whole, part]), joined([EdgeParts(none, none + 1.0, none + 1.0), parts])
