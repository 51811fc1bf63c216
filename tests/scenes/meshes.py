"""Meshes of triangles by formulas: balls, waves, sheets that cross."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from tests.scenes import diffuse
from torch_radbp.io.values.transform import rotate, scale, translate

POSE = translate((0.1, 0.05, 0)) @ rotate((1, 2, 3), 40) @ scale((0.6, 0.6, 0.6))


def icosphere(subdivisions: int) -> tuple[Tensor, Tensor]:
    """Vertices (V, 3) on the unit sphere and faces (20 * 4^subdivisions, 3)."""
    golden = (1 + 5**0.5) / 2
    corners = [np.roll((0, a, b * golden), turn) for turn in range(3) for a in (-1, 1) for b in (-1, 1)]
    vertices = np.array(corners) / np.hypot(1, golden)
    near = np.linalg.norm(vertices[:, None] - vertices[None], axis=2) < 1.1
    faces = np.array([(i, j, k) for i in range(12) for j in range(i) for k in range(j)
                      if near[i, j] and near[j, k] and near[i, k]])
    inwards = np.linalg.det(vertices[faces]) < 0
    faces[inwards] = faces[inwards][:, ::-1]
    for _ in range(subdivisions):
        sides = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), 1)
        unique, number = np.unique(sides, axis=0, return_inverse=True)
        middle = vertices[unique].sum(1)
        (a, b, c), (i, j, k) = (number.reshape(3, -1) + len(vertices)), faces.T
        vertices = np.concatenate([vertices, middle / np.linalg.norm(middle, axis=1, keepdims=True)])
        faces = np.concatenate([np.stack(face, 1) for face in ((i, a, c), (a, j, b), (c, b, k), (a, b, c))])
    return torch.from_numpy(vertices), torch.from_numpy(faces)


def ball(subdivisions: int = 1, bumps: float = 0.1) -> dict:
    """A bumpy ball with smooth normals that follow its vertices."""
    vertices, faces = icosphere(subdivisions)
    x, y, z = vertices.unbind(1)
    radius = 1 + bumps * torch.sin(5 * x) * torch.sin(4 * y + 1) * torch.sin(3 * z + 0.5)
    return {"type": "mesh", "vertex_positions": vertices * radius[:, None], "faces": faces, "recompute_normals": True}


def wavy(size: int = 9) -> dict:
    """A grid of triangles with waves."""
    u, v = (part.flatten() for part in torch.meshgrid(*(torch.linspace(-1, 1, size),) * 2, indexing="ij"))
    corner = torch.arange(size * (size - 1)).reshape(size - 1, size)[:, :-1].flatten()
    faces = torch.cat([torch.stack([corner, corner + 1, corner + size], 1),
                       torch.stack([corner + 1, corner + size + 1, corner + size], 1)])
    return {"type": "mesh", "bsdf": diffuse(0.5, 0.6, 0.4), "faces": faces,
            "vertex_positions": torch.stack([u, v, 0.4 * torch.sin(3 * u) * torch.cos(2 * v)], 1)}


def grid(divisions: int, height: float = 0.1, **attributes) -> dict:
    """A wavy square of 2 * divisions^2 triangles."""
    line = np.linspace(-1, 1, divisions + 1)
    x, y = np.meshgrid(line, line)
    corner = (np.arange(divisions)[:, None] * (divisions + 1) + np.arange(divisions)).reshape(-1)
    faces = np.concatenate([np.stack([corner, corner + 1, corner + divisions + 2], 1),
                            np.stack([corner, corner + divisions + 2, corner + divisions + 1], 1)])
    vertices = np.stack([x, y, height * np.sin(3 * x + 2 * y)], -1).reshape(-1, 3)
    return {"type": "mesh", "vertex_positions": torch.tensor(vertices), "faces": torch.tensor(faces), "bsdf": diffuse(0.5),
            **attributes}


RADIANCE = {"type": "bitmap", "raw": True, "filter_type": "nearest", "bitmap": torch.tensor([[[3, 2, 1], [0.25] * 3]])}


def level_sheet(size: int, u: float) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """A level sheet from -3 to 3 of so many squares a side: vertices, triangles, surface coordinates that are all alike."""
    side = torch.linspace(-3, 3, size + 1, dtype=torch.float64)
    x, y = torch.meshgrid(side, side, indexing="xy")
    first = (torch.arange(size)[:, None] * (size + 1) + torch.arange(size)).flatten()
    right, up = first + 1, first + size + 1
    faces = torch.cat([torch.stack([first, right, up + 1], 1), torch.stack([first, up + 1, up], 1)])
    return torch.stack([x, y, torch.zeros_like(x)], -1).view(-1, 3), faces, torch.tensor([[u, 0.5]]).repeat(len(x) ** 2, 1)


def crossing_sheets(size: int) -> tuple[dict, torch.Tensor]:
    """A mesh of a level sheet and a steep one, 45 degrees, higher on the right; and which vertices are those of that."""
    (level, faces, left), (steep, others, right) = level_sheet(size, 0.25), level_sheet(size, 0.75)
    turn = torch.as_tensor(rotate((0, 1, 0), -45))[:3, :3].double()
    places = torch.cat([level + torch.tensor([0.0137, 0.0071, 0.05]), steep @ turn.T])
    mesh = {"type": "mesh", "vertex_positions": places, "faces": torch.cat([faces, others + len(level)]),
            "vertex_texcoords": torch.cat([left, right]).double(), "emitter": {"type": "area", "radiance": RADIANCE}}
    return mesh, torch.arange(len(places)) >= len(level)
