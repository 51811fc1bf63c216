"""Smooth normals of triangle meshes."""

from __future__ import annotations

import operator

import torch
from torch import Tensor

from torch_radbp.tensors.differentiated import linear
from torch_radbp.tensors.vec import TINY, Vec3, cross, dot, gather, max_component, where

BLOCK = 1 << 15  # number of triangles that are processed at a time


def angle_weighted_normals(vertices: Tensor, faces: Tensor) -> Tensor:
    """Vertex normals: the face normals weighted by the angle of the corner, as in Mitsuba; differentiable.

    Args:
        vertices: (V, 3).
        faces: (F, 3) int64. Degenerate triangles have no weight.

    Returns:
        (V, 3) unit normals; (1, 0, 0) at a vertex without a triangle.

    Reference: Thuermer and Wuethrich 1998, "Computing Vertex Normals from Polygonal Facets".
    """
    positions = Vec3.of(vertices)
    total = Vec3.full(positions.x, 0.0)
    # By blocks, so that intermediate results stay in the processor's cache.
    for block in faces.split(BLOCK):
        corners, parts = block.T.flatten(), weighted_normals(positions, block)
        total = Vec3(*(component.index_add(0, corners, part) for component, part in zip(total, parts)))
    squared = dot(total, total)
    lone = squared == 0
    upright = Vec3(torch.ones_like(squared), torch.zeros_like(squared), torch.zeros_like(squared))
    return where(lone, upright, total * torch.sqrt(torch.where(lone, 1.0, squared)).reciprocal()).stack()


def weighted_normals(positions: Vec3, faces: Tensor) -> Vec3:
    """The unit normal of each triangle times the angle at each corner, (3 F,), all first corners first; 0 if degenerate."""
    first, second, third = (positions.map(lambda x, row=row: gather(x, row)) for row in faces.unbind(1))
    edges = second - first, third - second, first - third
    size = torch.stack([max_component(edge.detach().map(torch.abs)) for edge in edges]).amax(0)
    ahead, across, back = (edge / torch.where(size > 0, size, 1.0) for edge in edges)
    area = cross(ahead, across)
    proper = dot(area, area) > TINY
    height = torch.sqrt(torch.where(proper, dot(area, area), 1.0))
    angles = [linear(operator.mul, torch.atan2(height, -dot(a, b)), proper)
              for a, b in ((ahead, back), (across, ahead), (back, across))]
    normal = area * height.reciprocal()
    return normal.map(lambda x: torch.cat([x * a for a in angles]))
