"""Which vertices, edges and triangles of a mesh are adjacent."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_radbp.shape.welding import cells_of, weld_size
from torch_radbp.shape.welding import welded as first_at_place


def welded_vertices(vertices: Tensor) -> tuple[Tensor, int]:
    """The index of each vertex's distinct position, (V,) int64, and their number; equal up to rounding is equal."""
    if vertices.ndim != 2 or vertices.shape[1] != 3 or not len(vertices):
        raise ValueError(f"vertices must have shape (V, 3), got {tuple(vertices.shape)}")
    vertices = vertices.detach()
    first = first_at_place(cells_of(vertices, weld_size(vertices)))
    if first is None:
        return torch.arange(len(vertices), device=vertices.device), len(vertices)
    firsts, place = torch.unique(first, return_inverse=True)
    return place, len(firsts)


def unique_edges(faces: Tensor) -> Tensor:
    """The edges of triangles, each once, (E, 2) int64, the smaller vertex first. Triangles of two vertices have one."""
    return torch.unique(_sides_of(faces)[0], dim=0)


def _sides_of(faces: Tensor) -> tuple[Tensor, Tensor]:
    """The three sides of each triangle, the smaller vertex first, (S, 2) int64, and the triangle of each, (S,) int64."""
    faces = faces.long()
    sides = torch.cat([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).sort(dim=1).values
    whose = torch.arange(len(faces), device=faces.device).repeat(3)
    proper = sides[:, 0] != sides[:, 1]
    return sides[proper], whose[proper]


def neighbours_of(faces: Tensor) -> Tensor:
    """Pairs of triangles that share an edge, (P, 2) int64; of three or more at one edge, each with the next."""
    sides, whose = _sides_of(faces)
    _, edge = torch.unique(sides, dim=0, return_inverse=True)
    order = edge.argsort(stable=True)
    together = edge[order[1:]] == edge[order[:-1]]
    return torch.stack([whose[order[:-1]], whose[order[1:]]], 1)[together]
