"""Where edges are creases: two surfaces meet there that are shaded differently."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_radbp.boundary.edges import Edges
from torch_radbp.scene.tensors import TriangleTable
from torch_radbp.tensors.vec import rows

# How much of a jump an edge may be that is no silhouette. At a fold by the normals of two triangles, of which one may be
# turned round.
NONE, WHOLE, FOLD, TURNED = range(4)
SHADED = -1  # none, but that the light of a lamp may end there: inside of smooth surfaces that are no lamps themselves


def creases(edges: Edges, triangles: TriangleTable, shape: Tensor | None) -> Tensor:
    """Where edges are creases; see `Outline.crease`.

    Args:
        edges: of triangles of this table.
        triangles: of the scene, detached.
        shape: (T,) int32, that each triangle belongs to; None: all to the same.
    """
    here, there = (torch.div(corner, 3, rounding_mode="floor") for corner in edges.corner[:2])
    known = (edges.count == 2) if not triangles.attributes else torch.zeros_like(edges.count, dtype=torch.bool)
    if shape is not None:
        known &= rows(shape, here) == rows(shape, there)
    smooth = torch.full_like(known, triangles.vertices.n is not None)
    if triangles.smooth is not None:
        smooth &= rows(triangles.smooth, here) & rows(triangles.smooth, there)
    if edges.seam is not None:
        reads = triangles.vertices.uv is not None or bool(triangles.vertices.attributes)
        known &= ~edges.seam if reads else ~(edges.seam & smooth)
    fold = FOLD + edges.alike.int() * (TURNED - FOLD)
    emits = (rows(triangles.emitter, here) >= 0) & (rows(triangles.emitter, there) >= 0)
    inside = torch.where(emits, NONE, SHADED).to(fold.dtype)
    return torch.where(known, torch.where(smooth, inside, fold), WHOLE)
