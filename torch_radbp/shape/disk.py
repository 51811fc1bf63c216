"""The unit disk in the plane z = 0, facing +z."""

from __future__ import annotations

import math

import torch

from torch_radbp.plugin import BSDF, Emitter, Matrix4, register
from torch_radbp.shape.surface import Tessellated, Triangles, grid

SECTORS, RINGS = 256, 8


@register("shape", "disk")
class Disk(Tessellated):
    """A disk: the canonical unit disk under `to_world`; uv = (radius, angle / 2 pi).

    Parameters: `to_world` (4, 4). Tessellated into 256 sectors, circumscribed so that the area is exact.
    """

    whole = True

    def __init__(self, *, to_world: Matrix4 | None = None, flip_normals: bool = False, bsdf: BSDF | None = None,
                 emitter: Emitter | None = None):
        super().__init__(bsdf=bsdf, emitter=emitter, flip_normals=flip_normals)
        uv, faces = grid(RINGS, SECTORS)
        angle = 2 * math.pi * uv[:, 1]
        sector = 2 * math.pi / SECTORS
        radius = uv[:, 0] * math.sqrt(sector / math.sin(sector))
        vertices = torch.stack([radius * torch.cos(angle), radius * torch.sin(angle), torch.zeros_like(angle)], 1)
        collapsed = (vertices[faces[:, 0]] - vertices[faces[:, 2]]).norm(dim=1) < 1e-12
        collapsed |= (vertices[faces[:, 0]] - vertices[faces[:, 1]]).norm(dim=1) < 1e-12
        self.place(to_world, Triangles(vertices, faces[~collapsed], None, uv))
