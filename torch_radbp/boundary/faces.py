"""Triangles in the world inside of which the image may be discontinuous."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.geometry import Between, Corners, Geometry, positions
from torch_radbp.tensors.lookup import lookup


class Faces(NamedTuple):
    """F triangles in the world, as functions of lanes read them."""

    triangle: Tensor  # (F,) int32, rows of the scene's triangles
    instance: Tensor | None  # (F,) int32 instance as in a hit; None: the scene has none
    share: Tensor | None  # (F,) float64, probability of the triangle's selection; None: all are selected

    def between(self, geometry: Geometry) -> Between:
        """The vertices of the triangles, as rows of the vertex table."""
        return Between(*lookup(geometry.triangles.corners, self.triangle))

    def corners(self, geometry: Geometry) -> Corners:
        """The corners of the triangles in the world, attached; float64."""
        return positions(geometry, self.between(geometry), self.instance)


def joined_faces(parts: list[Faces]) -> Faces | None:
    """Joins several sets of triangles; None: there are none."""
    if len(parts) < 2:
        return parts[0] if parts else None
    shares = [part.share for part in parts]
    if any(share is not None for share in shares):
        shares = [torch.ones_like(part.triangle, dtype=torch.float64) if part.share is None else part.share
                  for part in parts]
    columns = [part.triangle for part in parts], [part.instance for part in parts], shares
    return Faces(*(None if column[0] is None else torch.cat(column) for column in columns))
