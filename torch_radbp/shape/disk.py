"""The unit disk in the plane z = 0, facing +z."""

from __future__ import annotations

import itertools
import math

import torch
from torch import Tensor

from torch_radbp.plugin import BSDF, Emitter, Matrix4, Medium, register
from torch_radbp.shape.surface import Tessellated, Triangles

SECTORS, RINGS = 256, 8


@register("shape", "disk")
class Disk(Tessellated):
    """A disk: the canonical unit disk under `to_world`; uv = (radius, angle / 2 pi).

    Parameters: `to_world` (4, 4). Tessellated into 256 sectors, circumscribed so that the area is exact.
    """

    whole = True

    def __init__(self, *, to_world: Matrix4 | None = None, flip_normals: bool = False, bsdf: BSDF | None = None,
                 emitter: Emitter | None = None,
                 interior: Medium | None = None, exterior: Medium | None = None):
        super().__init__(bsdf=bsdf, emitter=emitter, flip_normals=flip_normals, interior=interior, exterior=exterior)
        uv, faces = rings_of_triangles()
        angle = 2 * math.pi * uv[:, 1]
        sector = 2 * math.pi / SECTORS
        radius = uv[:, 0] * math.sqrt(sector / math.sin(sector))
        vertices = torch.stack([radius * torch.cos(angle), radius * torch.sin(angle), torch.zeros_like(angle)], 1)
        self.place(to_world, Triangles(vertices, faces, None, uv))


def rings_of_triangles() -> tuple[Tensor, Tensor]:
    """Tessellates the disk: (V, 2) coordinates float64, (F, 3) faces counter-clockwise in (radius, angle).

    The vertices of every other ring stand half a sector aside, so that in all triangles, but those at the seam, u grows
    towards the middle: brushed materials turn with the angle, and not from one half of a cell to the other.
    """
    even = torch.arange(SECTORS + 1, dtype=torch.float64) / SECTORS
    odd = torch.cat([even[:1], (even[1:] + even[:-1]) / 2, even[-1:]])
    centre = (odd[1:] + odd[:-1]) / 2
    angles = [centre, *(odd if ring % 2 else even for ring in range(1, RINGS + 1))]
    firsts = [0, *itertools.accumulate(map(len, angles))]
    faces = []
    for ring, (first, after) in enumerate(zip(firsts, firsts[1:-1])):
        inner, outer = first + torch.arange(len(angles[ring])), after + torch.arange(len(angles[ring + 1]))
        if ring % 2:  # each vertex inside the seam stands between two outer ones
            inner_apex, outer_apex = inner[1:-1], outer
        else:
            inner_apex, outer_apex = inner, outer[1:-1]
        faces.append(torch.stack([inner_apex, outer[:-1], outer[1:]], 1))
        if ring:
            faces.append(torch.stack([inner[:-1], outer_apex, inner[1:]], 1))
    radius = torch.cat([torch.full_like(each, ring / RINGS) for ring, each in enumerate(angles)])
    return torch.stack([radius, torch.cat(angles)], 1), torch.cat(faces)
