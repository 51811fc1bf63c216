"""T-junctions: vertices of a mesh on an edge of another triangle, where the surface continues without a gap."""

from __future__ import annotations

import torch
from torch import Tensor

OBLIQUE = 0.5377, 0.6180, 0.5735  # a direction that few edges are perpendicular to
MOST_PAIRS = 1 << 22  # of edges and vertices that are looked at together


def cut_at_vertices(points: Tensor, ends: Tensor, tolerance: float) -> tuple[Tensor, Tensor]:
    """Cuts edges into pieces at the vertices that lie on them (T-junctions).

    Args:
        points: (V, 3) float64, all vertices.
        ends: (2, B) int64, the vertices at the ends of edges.
        tolerance: the distance below which a vertex lies on an edge, or at its end.

    Returns:
        (P,) int64, the edge of each piece, ascending, and (2, P) int64 its ends, in the direction of the edge. Edges on
        which no vertex lies have no pieces.
    """
    edge, share, vertex = vertices_on(points, ends, tolerance)
    cut = edge.unique()
    edge = torch.cat([cut, edge, cut])
    share = torch.cat([torch.zeros_like(share[:1]).expand(len(cut)), share, torch.ones_like(share[:1]).expand(len(cut))])
    vertex = torch.cat([ends[0, cut], vertex, ends[1, cut]])
    order = share.argsort(stable=True)
    order = order[edge[order].argsort(stable=True)]
    edge, vertex = edge[order], vertex[order]
    inside = (edge[1:] == edge[:-1]) & (vertex[1:] != vertex[:-1])
    return edge[1:][inside], torch.stack([vertex[:-1], vertex[1:]])[:, inside]


def vertices_on(points: Tensor, ends: Tensor, tolerance: float) -> tuple[Tensor, Tensor, Tensor]:
    """The vertices on edges: (J,) int64 edges, positions along these, (J,) int64 vertices. Args: as `cut_at_vertices`."""
    height, own = points @ points.new_tensor(OBLIQUE), ends.unique()
    places, order = height[own].sort(stable=True)
    own, of_ends = own[order], height[ends]
    first = torch.searchsorted(places, of_ends.amin(0) - tolerance)
    counts = torch.searchsorted(places, of_ends.amax(0) + tolerance, right=True) - first
    block = torch.div(counts.cumsum(0) - counts, MOST_PAIRS, rounding_mode="floor")
    found = [on_edges(points, ends, own, edges, first[edges], counts[edges], tolerance)
             for edges in torch.arange(len(counts), device=counts.device).split(torch.bincount(block).tolist())]
    return tuple(map(torch.cat, zip(*found)))


def on_edges(points: Tensor, ends: Tensor, own: Tensor, edges: Tensor, first: Tensor, counts: Tensor,
             tolerance: float) -> tuple[Tensor, Tensor, Tensor]:
    """The vertices on some of the edges: each edge is compared with `counts` of the vertices `own`, from `first` on.

    Result and other args as of `vertices_on`.
    """
    edge = edges.repeat_interleave(counts)
    place = torch.arange(len(edge), device=edge.device) + (first - (counts.cumsum(0) - counts)).repeat_interleave(counts)
    vertex, (start, end) = own[place], points[ends[:, edge]]
    along, offset = end - start, points[vertex] - start
    length = along.norm(dim=1)
    share = (offset * along).sum(1) / length.square().clamp_min(torch.finfo(length.dtype).tiny)
    away = (offset - share[:, None] * along).norm(dim=1)
    on = (away <= tolerance) & (share * length > tolerance) & ((1.0 - share) * length > tolerance)
    return edge[on], share[on], vertex[on]
