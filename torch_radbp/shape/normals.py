"""Smooth normals of triangle meshes."""

from __future__ import annotations

import torch
from torch import Tensor


def angle_weighted_normals(vertices: Tensor, faces: Tensor) -> Tensor:
    """Face normals averaged with the corner's angle as weight, as Mitsuba does; differentiable.

    Args:
        vertices: (V, 3).
        faces: (F, 3) int64. Triangles without area do not count.

    Returns:
        (V, 3) unit normals; (1, 0, 0) at a vertex without a triangle.

    Reference: Thuermer and Wuethrich 1998, "Computing Vertex Normals from Polygonal Facets".
    """
    faces = faces[(doubled_areas(vertices.detach(), faces) != 0).any(1)]
    corners = vertices[faces]
    forward = unit(corners.roll(-1, 1) - corners)  # (F, corner, 3), to the next corner
    backward = -forward.roll(1, 1)
    angles = 2 * torch.atan2((forward - backward).norm(dim=2), (forward + backward).norm(dim=2))
    weighted = unit(doubled_areas(vertices, faces))[:, None] * angles[..., None]
    return unit(torch.zeros_like(vertices).index_add(0, faces.flatten(), weighted.flatten(0, 1)))


def doubled_areas(vertices: Tensor, faces: Tensor) -> Tensor:
    """(F, 3) normals whose lengths are twice the areas of the triangles."""
    first, second, third = vertices[faces].unbind(1)
    return torch.linalg.cross(second - first, third - first)


def unit(vectors: Tensor) -> Tensor:
    """(..., 3) vectors of length 1; (1, 0, 0) for zero, without a derivative."""
    zero = (vectors == 0).all(-1, keepdim=True)
    vectors = torch.where(zero, vectors.new_tensor([1.0, 0.0, 0.0]), vectors)
    return vectors / vectors.norm(dim=-1, keepdim=True)
