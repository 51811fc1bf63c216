"""The faces of a small mesh for `batches.py`: pairs of triangles that make up a parallelogram become one face.

Rooms, boxes and plates are made of rectangles. A ray has one plane to cross there, and four edges rather than six.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

CLOSE = 1e-6  # how far the fourth corner may be from where it belongs, of the diagonal


class MergedFaces(NamedTuple):
    """The P faces of F triangles, in the order of their first triangles."""

    points: Tensor  # (N, 3) distinct positions of corners
    corners: Tensor  # (P, 4) int64, rows of `points` in order around the face; a triangle repeats its first
    prims: Tensor  # (P, 2) int32, the triangle of corners 0, 1, 2 and that of 0, 2, 3, which may be the same
    parallelogram: Tensor  # (P,) bool


def faces_of(p: Tensor) -> MergedFaces:
    """Merges pairs of triangles that make up parallelograms; other triangles remain faces by themselves.

    Two triangles are one face if either has the edge between them as its longest, nobody else has that edge as its longest,
    and their corners are, within rounding, those of a parallelogram.

    Args:
        p: (F, 3, 3) the corners of triangles.
    """
    number = torch.arange(len(p), device=p.device)
    points, corners = _places_of(p.flatten(0, 1))
    corners = corners.reshape(-1, 3)
    lengths = (p[:, [1, 2, 0]] - p[:, [2, 0, 1]]).square().sum(2)  # of the edges opposite to the corners
    turned = (lengths.argmax(1, keepdim=True) + torch.arange(3, device=p.device)) % 3
    apex, start, end = corners.gather(1, turned).T

    # Triangles whose longest edges have the same ends follow each other.
    edge, order = (torch.minimum(start, end) * len(points) + torch.maximum(start, end)).sort(stable=True)
    alike = torch.nn.functional.pad(edge[1:] == edge[:-1], (1, 1))
    pair = (alike[1:-1] & ~alike[:-2] & ~alike[2:]).nonzero().squeeze(1)
    first, second = order[pair], order[pair + 1]
    off = points[start[first]] + points[end[first]] - points[apex[first]] - points[apex[second]]
    fits = off.abs().amax(1) <= CLOSE * (points[start[first]] - points[end[first]]).abs().amax(1)
    first, second = first[fits], second[fits]

    corners = torch.cat([corners, corners[:, :1]], 1)
    corners[first] = torch.stack([start[first], apex[first], end[first], apex[second]], 1)
    partner, kept = number.clone(), torch.ones_like(number, dtype=torch.bool)
    partner[first] = second
    kept[second] = False
    prims = torch.stack([number, partner], 1)[kept]
    return MergedFaces(points, corners[kept], prims.to(torch.int32), prims[:, 0] != prims[:, 1])


def _places_of(points: Tensor) -> tuple[Tensor, Tensor]:
    """The distinct points among (N, 3), and the index of each point into them, (N,) int64."""
    place = 0
    for numbers in points.T:  # one by one: torch sorts rows slowly
        distinct, number = torch.unique(numbers, return_inverse=True)
        place = place * len(distinct) + number
    distinct, place = torch.unique(place, return_inverse=True)
    return points.new_empty(len(distinct), 3).index_copy(0, place, points), place
