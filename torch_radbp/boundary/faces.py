"""The triangles inside of which an image may jump, in the world."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.places import Between, Placed
from torch_radbp.scene.placement import shown, shown_normals
from torch_radbp.scene.tensors import SceneTensors
from torch_radbp.vec import Vec3, rows

Corners = tuple[Vec3, Vec3, Vec3]


class Faces(NamedTuple):
    """F triangles in the world."""

    triangle: Tensor  # (F,) int64, rows of the scene's triangles
    instance: Tensor | None  # (F,) int32 that shows each, as hits count; None: the scene has none
    share: Tensor  # (F,) probability with which a triangle is among these

    def between(self, scene: SceneTensors) -> Between:
        """The vertices."""
        return Between(*(corner.index_select(0, self.triangle).long() for corner in scene.triangles.corners))


def positions(scene: SceneTensors, between: Between, instance: Tensor | None) -> Corners:
    """The vertices of triangles in the world, attached; float64."""
    points = tuple(rows(scene.triangles.vertices.p, corner) for corner in between)
    points = points if instance is None else shown(scene, Placed(instance), points)
    return tuple(point.map(torch.Tensor.double) for point in points)


def vertex_normals(scene: SceneTensors, between: Between, instance: Tensor | None) -> Corners:
    """The shading normals there, unit length."""
    normals = tuple(rows(scene.triangles.vertices.n, corner) for corner in between)
    normals = normals if instance is None else shown_normals(scene, Placed(instance), normals)
    return tuple(normal.map(torch.Tensor.double) for normal in normals)


def joined(parts: list[Faces]) -> Faces | None:
    """All of several faces; None: there are none."""
    if len(parts) < 2:
        return parts[0] if parts else None
    return Faces(*(None if column[0] is None else torch.cat(column) for column in zip(*parts)))
