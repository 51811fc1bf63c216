"""The closest points of a mesh to given points."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

FIRST = 4  # triangles whose middles are closest, that are looked at first


class OnMesh(NamedTuple):
    """Q points on a mesh, in barycentric coordinates."""

    triangle: Tensor  # (Q,) int64
    weights: Tensor  # (Q, 3) barycentric

    def of_vertices(self, rows: Tensor, faces: Tensor) -> Tensor:
        """Interpolates vertex attributes, (V, ...), at the points, (Q, ...); `faces`: (F, 3), of the mesh."""
        corner, weights = faces[self.triangle].to(rows.device), self.weights.to(rows)
        return (rows[corner] * weights.view(-1, 3, *[1] * (rows.ndim - 1))).sum(1)

    def of_faces(self, rows: Tensor) -> Tensor:
        """Face attributes, (F, ...), at the points, (Q, ...)."""
        return rows[self.triangle.to(rows.device)]


def closest_points(points: Tensor, vertices: Tensor, faces: Tensor) -> OnMesh:
    """The closest points of a mesh to (Q, 3) points.

    Of ever more triangles, those whose middles are closest, until no other can be closer: none of the others has a point
    within the distance of its middle less the largest radius. Of these, those that their own radius rules out are skipped.

    Args:
        points: float64, on the CPU, as are the vertices.
        vertices: (V, 3).
        faces: (F, 3).
    """
    from scipy.spatial import cKDTree

    corners = vertices[faces]
    middle = corners.mean(1)
    radius = (corners - middle[:, None]).norm(dim=2).amax(1)
    tree = cKDTree(middle.numpy())
    triangle, weights = torch.zeros(len(points), dtype=torch.int64), points.new_zeros(len(points), 3)
    nearest = points.new_full((len(points),), torch.inf)
    open_, looked_at = torch.arange(len(points)), FIRST
    while len(open_):
        looked_at = min(looked_at, len(faces))
        far, candidates = tree.query(points[open_].numpy(), looked_at)
        far, candidates = (torch.from_numpy(part).view(len(open_), looked_at) for part in (far, candidates))
        possible = far - radius[candidates] < nearest[open_, None]
        row, column = possible.nonzero(as_tuple=True)
        own_weights, own_distance = closest_in_triangles(points[open_[row]], corners[candidates[row, column]])
        distance, all_weights = torch.full_like(far, torch.inf), far.new_zeros(*far.shape, 3)
        distance[row, column], all_weights[row, column] = own_distance, own_weights
        least, best = distance.min(1)
        closer = (least < nearest[open_]).nonzero().squeeze(1)
        place, best = open_[closer], best[closer]
        triangle[place], weights[place], nearest[place] = candidates[closer, best], all_weights[closer, best], least[closer]
        unsure = (nearest[open_] > far[:, -1] - radius.max()) & (looked_at < len(faces))
        open_, looked_at = open_[unsure], 4 * looked_at
    return OnMesh(triangle, weights)


def closest_in_triangles(points: Tensor, corners: Tensor) -> tuple[Tensor, Tensor]:
    """Barycentric coordinates of the closest points in triangles, (..., 3), and their distances, (...).

    Args:
        points: (..., 3).
        corners: (..., 3, 3).
    """
    a, b, c = corners.unbind(-2)
    points = points.expand_as(a)
    normal = torch.linalg.cross(b - a, c - a)
    area = normal.square().sum(-1)
    inside = torch.stack([(torch.linalg.cross(c - b, points - b) * normal).sum(-1),
                          (torch.linalg.cross(a - c, points - c) * normal).sum(-1),
                          (torch.linalg.cross(b - a, points - a) * normal).sum(-1)], -1)
    inside = inside / torch.where(area > 0, area, 1.0)[..., None]
    candidates = [torch.where((inside.min(-1).values >= 0) & (area > 0), 1.0, torch.nan)[..., None] * inside]
    for first in range(3):
        second = (first + 1) % 3
        start, along = corners[..., first, :], corners[..., second, :] - corners[..., first, :]
        length = along.square().sum(-1)
        share = (((points - start) * along).sum(-1) / torch.where(length > 0, length, 1.0)).clamp(0, 1)
        side = torch.zeros_like(inside)
        side[..., first], side[..., second] = 1 - share, share
        candidates.append(side)
    weights = torch.stack(candidates, -2)
    distance = ((weights[..., None] * corners[..., None, :, :]).sum(-2) - points[..., None, :]).norm(dim=-1)
    distance, best = torch.where(distance.isnan(), torch.inf, distance).min(-1)
    return weights.gather(-2, best[..., None, None].expand(*best.shape, 1, 3)).squeeze(-2), distance
