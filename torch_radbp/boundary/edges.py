"""The edges of triangle meshes, and which triangles meet there."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

WELDED = 1e-5  # vertices nearer than about this share of the mesh's extent count as one


class Edges(NamedTuple):
    """E edges, at which H corners of triangles lie opposite (two at an edge inside of a surface)."""

    a: Tensor  # (E,) int64, one end
    b: Tensor  # (E,) the other
    opposite: Tensor  # (H,) int64, the third vertex of a triangle
    edge: Tensor  # (H,) int64, of which edge


def edges_of(vertices: Tensor, faces: Tensor) -> Edges:
    """All edges of a mesh. Vertices in the same place are one, and triangles without extent are none.

    Args:
        vertices: (V, 3), detached.
        faces: (F, 3) integers.
    """
    corner = welded(vertices)[faces.long()]
    degenerate = (corner == corner.roll(1, 1)).any(1)
    first, second, third = corner[~degenerate].unbind(1)
    ends = torch.stack([torch.cat([first, second, third]), torch.cat([second, third, first])])
    count = max(len(vertices), 1)
    keys, edge = torch.unique(ends.amin(0) * count + ends.amax(0), return_inverse=True)
    return Edges(keys // count, keys % count, torch.cat([third, first, second]), edge)


def welded(vertices: Tensor) -> Tensor:
    """(V,) int64: of each vertex the first one in the same place, up to rounding."""
    label = torch.arange(len(vertices), device=vertices.device)
    extent = float((vertices.amax(0) - vertices.amin(0)).max()) if len(vertices) else 0.0
    if extent == 0.0:
        return torch.zeros_like(label)
    # Powers of ten, because coordinates that people write are multiples of them; two grids, for those that lie between.
    cell = 10.0 ** math.floor(math.log10(extent * WELDED))
    places = (vertices.double() - vertices.double().amin(0)) / cell
    groups = []
    for shift in (0.5, 1.0):
        x, y, z = torch.floor(places + shift).long().unbind(1)
        groups.append(torch.unique((x << 42) | (y << 21) | z, return_inverse=True)[1])
    for group in groups * 2:
        least = torch.full_like(label, len(vertices)).scatter_reduce(0, group, label, "amin")
        label = least[group]
    return label
