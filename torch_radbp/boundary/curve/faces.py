"""Triangles in the world inside of which the image may be discontinuous."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.curve.geometry import Between, Corners, Geometry, positions
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.record import joined, leaves_of


class Faces(NamedTuple):
    """F triangles of a scene, some of which may come from instances, as stages read them."""

    triangle: Tensor  # (F,) int32, rows of the scene's triangles
    instance: Tensor | None  # (F,) int32 instance as in a hit; None: the scene has none
    share: Tensor | None  # (F,) float64, probability of the triangle's selection; None: all are selected

    def between(self, geometry: Geometry) -> Between:
        """The vertices of the triangles, as rows of the vertex table."""
        return Between(*lookup(geometry.triangles.corners, self.triangle))

    def corners(self, geometry: Geometry) -> Corners:
        """The corner positions of the triangles in the world, attached; float64."""
        return positions(geometry, self.between(geometry), self.instance)


def joined_faces(parts: list[Faces]) -> Faces | None:
    """Joins several sets of triangles; None: there are none."""
    if len(parts) < 2:
        return parts[0] if parts else None
    return joined(with_shares(parts))


def with_shares(parts: Sequence[Any]) -> list[Any]:
    """The records, with ones, (N,) float64, in the place of a missing `share`, unless all of them lack it."""
    if all(part.share is None for part in parts):
        return list(parts)
    return [part if part.share is not None else part._replace(share=torch.ones_like(leaves_of(part)[0], dtype=torch.float64))
            for part in parts]
