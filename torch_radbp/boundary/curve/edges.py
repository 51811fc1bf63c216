"""The edges of triangle meshes, with the triangles that meet there."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.curve.junctions import cut_at_vertices
from torch_radbp.jit.order import chosen as chosen_lanes
from torch_radbp.jit.order import in_order
from torch_radbp.shape.welding import cells_of, weld_size, welded
from torch_radbp.tensors.record import joined as joined_records
from torch_radbp.tensors.vec import rows

MOST_MEETING = 8  # triangles at an edge that are told apart


class Edges(NamedTuple):
    """E edges of a mesh, and the triangles that meet at each, at most `MOST_MEETING`."""

    a: Tensor  # (E,) int32, one end, a row of the mesh's vertices, of the first triangle
    b: Tensor  # (E,) the other
    opposite: tuple[Tensor, ...]  # (E,) int32 each, third vertex of each triangle; with fewer triangles the first repeats
    corner: tuple[Tensor, ...]  # (E,) int32 each, index of that corner among all corners
    count: Tensor  # (E,) int32, number of triangles at the edge
    alike: Tensor  # (E,) bool: the first two triangles run along it in the same direction, so that one is flipped
    seam: Tensor | None  # (E,) bool: those two have different vertices there; None: nowhere


def joined_edges(parts: Sequence[Edges]) -> Edges:
    """Joins several sets of edges into one."""
    most = max(len(part.corner) for part in parts)
    return parts[0] if len(parts) < 2 else joined_records([padded(part, most) for part in parts])


def padded(edges: Edges, most: int) -> Edges:
    """The edges with columns for at least `most` triangles each, filled by repetition."""
    opposite, corner = (column + column[:1] * (most - len(column)) for column in (edges.opposite, edges.corner))
    return edges._replace(opposite=opposite, corner=corner)


def edges_of(vertices: Tensor, faces: Tensor) -> Edges:
    """Finds the edges of a mesh.

    Vertices at the same place count as one; an edge has those of its first triangle, since others may belong to shapes that
    touch it and move differently. Degenerate triangles are skipped; an edge of only one triangle is split at every vertex
    that lies on it.

    Args:
        vertices: (V, 3), detached; may begin and end with vertices of other meshes.
        faces: (F, 3) integers, F > 0.
    """
    first, last = map(int, faces.aminmax())
    faces = faces.int() - first if first else faces.int()
    vertices = vertices[first:last + 1]
    size = weld_size(vertices)
    label = welded(cells_of(vertices, size))
    corner = faces if label is None else label[faces]
    sides, flat, cut = _sides_of(corner), faces.flatten(), False
    edges = _met(sides, len(vertices))
    border = edges.side[0][edges.count == 1].long()
    if len(border):
        ends = torch.where(sides.forward[border], sides.low[border], sides.high[border]), torch.where(
            sides.forward[border], sides.high[border], sides.low[border])
        which, pieces = cut_at_vertices(vertices.double(), torch.stack(ends).long(), size)
        cut = len(which) > 0
        if cut:
            whole = torch.ones_like(sides.forward).index_fill(0, border[which], False)
            parts = sides_between(*pieces.int(), sides.corner[border[which]])
            sides = Sides(*(torch.cat([side[whole], part]) for side, part in zip(sides, parts)))
            edges = _met(sides, len(vertices))
    corners = tuple(rows(sides.corner, side) for side in edges.side)
    alike = (edges.count > 1) & (rows(sides.forward, edges.side[0]) == rows(sides.forward, edges.side[1]))
    seam = None if label is None and not cut else (edges.count == 2) & ~have_same_ends(flat, *corners[:2])
    ends = [edges.low, edges.high, *(rows(flat, number) for number in corners)]
    if label is not None:
        ends[:2] = ends_of_side(flat, label, corners[0], edges)
    a, b, *opposite = (first + end for end in ends) if first else ends
    return Edges(a, b, tuple(opposite), corners, edges.count, alike, seam)


class Sides(NamedTuple):
    """H sides of triangles, each given by its end vertices and the opposite corner; (H,)."""

    low: Tensor  # int32, its end with the lesser index
    high: Tensor
    forward: Tensor  # bool: the triangle runs along it from `low` to `high`
    corner: Tensor  # int32, index of the opposite corner


def sides_between(start: Tensor, end: Tensor, corner: Tensor) -> Sides:
    """The sides of triangles between given vertices, (H,) int32, opposite given corners."""
    return Sides(torch.minimum(start, end), torch.maximum(start, end), start < end, corner)


def _sides_of(faces: Tensor) -> Sides:
    """The sides of all triangles, (F, 3) int32, that are not degenerate."""
    number = torch.arange(0, 3 * len(faces), 3, dtype=torch.int32, device=faces.device)
    one, two, three = faces.unbind(1)
    proper = (one != two) & (two != three) & (three != one)
    if not proper.all():
        one, two, three, number = (column[proper] for column in (one, two, three, number))
    # Written where they stay: of a large mesh this takes half as long as to put them together.
    sides = Sides(*(torch.empty(3, len(one), dtype=dtype, device=faces.device)
                    for dtype in (torch.int32, torch.int32, torch.bool, torch.int32)))
    for place, (start, end, corner) in enumerate(((one, two, 2), (two, three, 0), (three, one, 1))):
        low, high, forward, own = (side[place] for side in sides)
        torch.minimum(start, end, out=low)
        torch.maximum(start, end, out=high)
        torch.lt(start, end, out=forward)
        torch.add(number, corner, out=own)
    return Sides(*(side.flatten() for side in sides))


class Meeting(NamedTuple):
    """E edges as groups of triangle sides that coincide."""

    low: Tensor  # (E,) int32, its ends
    high: Tensor
    side: tuple[Tensor, ...]  # (E,) int32 each, sides at the edge; with fewer the first repeats
    count: Tensor  # (E,) int32, number of sides


def _met(sides: Sides, vertices: int) -> Meeting:
    """Groups triangle sides with the same end vertices into edges."""
    order, low, high = in_order(sides.low, sides.high, vertices)
    begins = torch.ones_like(sides.forward)
    begins[1:] = (low[1:] != low[:-1]) | (high[1:] != high[:-1])
    first = chosen_lanes(begins)
    low, high = rows(low, first), rows(high, first)
    count = torch.diff(first, append=first.new_full((1,), len(order)))
    most = max(2, min(MOST_MEETING, int(count.max()) if len(count) else 0))
    side = tuple(rows(order, first + (count > place).int() * place) for place in range(most))
    return Meeting(low, high, side, count)


def ends_of_side(flat: Tensor, label: Tensor, corner: Tensor, edges: Meeting) -> list[Tensor]:
    """The vertices of given triangles at the ends of edges, (E,) int32 each; for a part of a side, the edge's own ends.

    Args:
        flat: (3 F,) int32, the vertices at all corners.
        label: (V,) int32, for each vertex the first one at the same place.
        corner: (E,) int32, the corners opposite the edges in these triangles.
        edges: the edges, whose ends are given by first vertices.
    """
    one, two = sides_ends(flat, corner)
    return [torch.where(rows(label, one) == end, one, torch.where(rows(label, two) == end, two, end))
            for end in (edges.low, edges.high)]


def sides_ends(flat: Tensor, corner: Tensor) -> tuple[Tensor, Tensor]:
    """The end vertices of the sides opposite given corners, (E,) int32 each; args as for `ends_of_side`."""
    return (rows(flat, corner + torch.where(corner % 3 == 2, -2, 1).int()),
            rows(flat, corner + torch.where(corner % 3 == 0, 2, -1).int()))


def have_same_ends(flat: Tensor, one: Tensor, two: Tensor) -> Tensor:
    """(E,) bool: the sides opposite two corners, (E,) int32 each, have the same vertices.

    Args:
        flat: (3 F,) int32, the vertices at all corners.
    """
    (a, b), (c, d) = (sides_ends(flat, corner) for corner in (one, two))
    return ((a == c) & (b == d)) | ((a == d) & (b == c))
