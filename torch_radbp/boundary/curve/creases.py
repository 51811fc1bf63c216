"""Creases: edges where two surfaces meet that are shaded differently."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_radbp.boundary.curve.edges import Edges
from torch_radbp.scene.tables.scene_tensors import TriangleTable
from torch_radbp.tensors.vec import rows

# How much of a jump an edge may be that is no silhouette. At a fold by the normals of two triangles, of which one may be
# turned round.
NONE, WHOLE, FOLD, TURNED = range(4)
SHADED = -1  # none, but that the light of a lamp may end there: inside of smooth surfaces that are no lamps themselves


def creases(edges: Edges, triangles: TriangleTable, shape: Tensor | None) -> Tensor:
    """How an image may jump at edges that are no silhouettes, (E,) int32: not at all, by anything, or as much as they fold.

    Args:
        edges: of triangles of this table.
        triangles: of the scene, detached.
        shape: (T,) int32, the shape of each triangle; None: all belong to one.
    """
    def of_both(column: Tensor) -> tuple[Tensor, Tensor]:
        """A column of the triangle table for both triangles at each edge."""
        return tuple(rows(column, torch.div(corner, 3, rounding_mode="floor")) for corner in edges.corner[:2])

    known = (edges.count == 2) if not triangles.attributes else torch.zeros_like(edges.count, dtype=torch.bool)
    if shape is not None:
        known &= torch.eq(*of_both(shape))
    smooth = torch.full_like(known, triangles.vertices.n is not None)
    if triangles.smooth is not None:
        smooth &= torch.logical_and(*of_both(triangles.smooth))
    if edges.seam is not None:
        reads = triangles.vertices.uv is not None or bool(triangles.vertices.attributes)
        known &= ~edges.seam if reads else ~(edges.seam & smooth)
    jump = FOLD + edges.alike.int() * (TURNED - FOLD)
    if triangles.vertices.n is not None:
        here, there = of_both(triangles.emitter)
        jump = torch.where(smooth, torch.where((here >= 0) & (there >= 0), NONE, SHADED).int(), jump)
    return torch.where(known, jump, WHOLE)
