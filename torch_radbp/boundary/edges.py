"""The edges of triangle meshes, and which triangles meet there."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.junctions import cut_at_vertices

WELDED = 1e-5  # vertices nearer than about this share of the mesh's extent count as one
HASH, SLOTS = 0x1E3779B97F4A7C15, 1 << 22  # the multiplier of a hash, and how many values it has
MANY = 1 << 16  # triangles of a shape of which all are looked at
SOME = 1 << 14  # triangles of a larger shape that are looked at


class Edges(NamedTuple):
    """E edges between U vertices, at which H corners of triangles lie opposite (two at an edge inside a surface)."""

    vertex: Tensor  # (U,) int64, rows of the mesh's vertices; a, b and opposite index this field
    a: Tensor  # (E,) int64, one end
    b: Tensor  # (E,) the other
    opposite: Tensor  # (H,) int64, the third vertex of a triangle
    edge: Tensor  # (H,) int64, of which edge
    corner: Tensor  # (H,) int64, its number among all corners, three of each triangle in the order of the faces


def spread(counts: Sequence[int], device: torch.device) -> Tensor | None:
    """The triangles whose edges are examined: all those of small shapes, a fixed random sample of those of large ones.

    This bounds the work. A large mesh with a single silhouette edge is rare, and the sample may miss that edge.

    Args:
        counts: the number of triangles of each shape, in the order of the faces.
        device: of the result.

    Returns:
        Ascending int64 row numbers; None: all.
    """
    if max(counts) <= MANY:
        return None
    generator, parts, first = torch.Generator("cpu").manual_seed(0), [], 0
    for count in counts:
        some = torch.randint(count, (SOME,), generator=generator, device="cpu").unique() if count > MANY else None
        parts.append(first + (torch.arange(count, device="cpu") if some is None else some))
        first += count
    return torch.cat(parts).to(device)


def edges_of(vertices: Tensor, faces: Tensor, chosen: Tensor | None = None) -> Edges:
    """The edges of a mesh, or of some of its triangles.

    Vertices at the same place count as one; degenerate triangles are skipped; an edge of one triangle ends at every vertex
    that lies on it. The neighbours of the chosen triangles are found without sorting the whole mesh.

    Args:
        vertices: (V, 3), detached; may begin and end with vertices of other meshes.
        faces: (F, 3) integers, F > 0.
        chosen: (C,) rows of `faces`, distinct; None: all.
    """
    first = int(faces.min())
    faces = faces - first
    vertices = vertices[first:first + int(faces.max()) + 1]
    size = weld_size(vertices)
    cells = cells_of(vertices, size)
    near = torch.arange(len(faces), device=faces.device)
    if chosen is not None:
        near = touching(cells, faces, faces[chosen].flatten().long())
    vertex, corner = torch.unique(faces[near].long(), return_inverse=True)
    corner = welded(tuple(cell[vertex] for cell in cells))[corner]
    proper = ~(corner == corner.roll(1, 1)).any(1)
    one, two, three = corner[proper].unbind(1)
    ends = torch.stack([torch.cat([one, two, three]), torch.cat([two, three, one])])
    opposite, corners = torch.cat([three, one, two]), torch.cat([3 * near[proper] + place for place in (2, 0, 1)])
    keys, edge = numbered(ends, len(vertex))
    border = (torch.bincount(edge)[edge] == 1).nonzero().squeeze(1)
    if len(border):
        which, pieces = cut_at_vertices(vertices[vertex].double(), ends[:, border], size)
        if len(which):
            whole = torch.ones(len(edge), dtype=torch.bool, device=edge.device).index_fill(0, border[which], False)
            ends = torch.cat([ends[:, whole], pieces], 1)
            opposite, corners = (torch.cat([part[whole], part[border[which]]]) for part in (opposite, corners))
            keys, edge = numbered(ends, len(vertex))
    edges = Edges(first + vertex, keys // len(vertex), keys % len(vertex), opposite, edge, corners)
    if chosen is None:
        return edges
    wanted = torch.zeros(len(faces), dtype=torch.bool, device=faces.device).index_fill(0, chosen, True)
    return kept(edges, wanted[corners // 3])


def numbered(ends: Tensor, vertices: int) -> tuple[Tensor, Tensor]:
    """The pairs of vertices that occur at the `ends`, (2, H), of edges, (E,) int64, a * vertices + b with a < b; and (H,)
    which of these each has."""
    return torch.unique(ends.amin(0) * vertices + ends.amax(0), return_inverse=True)


def kept(edges: Edges, corners: Tensor) -> Edges:
    """The edges that have one of the marked corners, (H,) bool, opposite them; with all corners opposite these edges."""
    keep = torch.zeros(len(edges.a), dtype=torch.bool, device=corners.device).index_fill(0, edges.edge[corners], True)
    there = keep[edges.edge]
    return Edges(edges.vertex, edges.a[keep], edges.b[keep], edges.opposite[there],
                 (keep.cumsum(0) - 1)[edges.edge[there]], edges.corner[there])


def touching(cells: tuple[Tensor, Tensor], faces: Tensor, vertices: Tensor) -> Tensor:
    """The triangles with at least two corners at the places of the given vertices; ascending rows of `faces`."""
    touched = torch.zeros(len(cells[0]), dtype=torch.bool, device=faces.device)
    for cell in cells:
        slot = ((cell * HASH) >> 32) & (SLOTS - 1)  # cells may share a slot: a few more triangles do no harm
        touched |= torch.zeros(SLOTS, dtype=torch.bool, device=faces.device).index_fill(0, slot[vertices], True)[slot]
    first, second, third = (touched.index_select(0, corner) for corner in faces.unbind(1))
    return ((first & second) | (second & third) | (third & first)).nonzero().squeeze(1)


def weld_size(vertices: Tensor) -> float:
    """The distance below which the vertices of a mesh, (V, 3), count as one."""
    extent = float((vertices.amax(0) - vertices.amin(0)).max())
    # Powers of ten, because coordinates that people write are multiples of them.
    return 10.0 ** math.floor(math.log10(extent * WELDED)) if extent > 0.0 else 1.0


def cells_of(vertices: Tensor, size: float) -> tuple[Tensor, Tensor]:
    """The cells, of this size, of two grids that contain the vertices, (V, 3); (V,) int64 each.

    One grid is shifted by half a cell against the other, so that vertices at the same place, up to rounding, share a cell
    of at least one of them.
    """
    places = (vertices.double() - vertices.amin(0).double()) / size
    cells = []
    for shift in (0.5, 1.0):
        x, y, z = torch.floor(places + shift).long().unbind(1)
        cells.append((x << 42) | (y << 21) | z)
    return tuple(cells)


def welded(cells: tuple[Tensor, Tensor]) -> Tensor:
    """For each vertex the first one at the same place, (V,) int64, by the cells from `cells_of`."""
    label = torch.arange(len(cells[0]), device=cells[0].device)
    groups = [torch.unique(cell, return_inverse=True)[1] for cell in cells]
    for group in groups * 2:
        least = torch.full_like(label, len(label)).scatter_reduce(0, group, label, "amin")
        label = least[group]
    return label
