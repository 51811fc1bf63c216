"""Shapes that are recovered, and how far they are from true ones that have other triangles."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torch_radbp.formats.mesh import read_mesh
from torch_radbp.optim.closest import closest_points
from torch_radbp.training.recovery.recovered import RecoveredParameter
from torch_radbp.transforms import transform_points

POINTS, POINTS_OF_STEP = 2000, 300  # on each surface, for a report and for the curve of a run


class Surface(NamedTuple):
    """A triangle mesh, float64, on the CPU."""

    vertices: Tensor  # (V, 3)
    faces: Tensor  # (F, 3) int64

    def points(self, count: int) -> Tensor:
        """(count, 3) points spread evenly over the area; of the same mesh always the same."""
        corners = self.vertices[self.faces]
        area = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).norm(dim=1)
        generator = torch.Generator().manual_seed(0)
        u, v, stratum = torch.rand(3, count, generator=generator, dtype=torch.float64)
        share = (torch.arange(count, dtype=torch.float64) + stratum) / count * area.sum()
        chosen = corners[torch.searchsorted(area.cumsum(0), share).clamp_max(len(area) - 1)]
        root = u.sqrt()  # uniform in a triangle
        weights = torch.stack([1 - root, root * (1 - v), root * v], 1)
        return (weights[:, :, None] * chosen).sum(1)

    def mean_distance(self, points: Tensor) -> float:
        """The mean distance of points from the surface."""
        nearest = closest_points(points, self.vertices, self.faces).of_vertices(self.vertices, self.faces)
        return (points - nearest).norm(dim=1).mean().item()


def read_surface(path: Path, to_world: Tensor) -> Surface:
    """Reads a mesh that stands in the place of another one, whose (4, 4) transform to world space it gets."""
    mesh = read_mesh(path, want_normals=False)
    vertices = transform_points(to_world.detach().double().cpu(), torch.from_numpy(mesh.vertices))
    return Surface(vertices, torch.from_numpy(mesh.faces))


def chamfer_distance(one: Surface, other: Surface, points: int = POINTS) -> float:
    """The mean distance of so many points of each surface from the other surface, in their units."""
    return (other.mean_distance(one.points(points)) + one.mean_distance(other.points(points))) / 2


@dataclass
class RecoveredShape(RecoveredParameter):
    """The vertices of a mesh whose true surface is known.

    Attributes:
        surface: the true one.
    """

    surface: Surface = field(kw_only=True)

    def distance(self, vertices: Tensor, points: int = POINTS) -> float:
        """The Chamfer distance of the mesh with these vertices from the true surface."""
        mesh = Surface(vertices.detach().double().cpu(), self.module.faces.long().cpu())
        return chamfer_distance(mesh, self.surface, points)

    @property
    def distance_column(self) -> str:
        return f"{self.name}:chamfer"

    def columns(self, value: Tensor) -> dict[str, float]:
        return {f"{self.name}:mean": value.mean().item(), self.distance_column: self.distance(value, POINTS_OF_STEP)}

    @property
    def size(self) -> float:
        """Half of the diagonal of the true surface's bounding box."""
        return (self.surface.vertices.amax(0) - self.surface.vertices.amin(0)).norm().item() / 2

    def compared(self, value: Tensor) -> dict[str, Any]:
        return {"chamfer": self.distance(value), "chamfer_before": self.distance(self.before)}
