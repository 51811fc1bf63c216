"""The cylinder, open at both ends."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torch_radbp.plugin import BSDF, Emitter, Matrix4, Medium, Point3, finite, positive, register
from torch_radbp.shape.surface import Tessellated, Triangles, grid
from torch_radbp.tensors.vec import Frame, Vec3
from torch_radbp.transforms import affine

SECTORS = 512
START, END = (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)  # of the unit cylinder's axis


@register("shape", "cylinder")
class Cylinder(Tessellated):
    """A cylinder without caps, normals outwards, with exact shading normals; uv = (azimuth / 2 pi, height / length).

    Parameters: `to_world` (4, 4). `p0`, `p1` and `radius` become a part of `to_world`. Tessellated into 512 sectors of the
    same area; the deviation from the exact surface is 1.3e-5 of the radius.

    Args:
        p0: the end of the axis where v is 0; None: (0, 0, 0).
        p1: the other end, where v is 1; None: (0, 0, 1).
        radius: before `to_world`, which may make the cylinder elliptical.

    Raises:
        ValueError: if `p0` and `p1` coincide, or `radius` is not positive.
    """

    whole = True

    def __init__(self, *, p0: Point3 | None = None, p1: Point3 | None = None, radius: float = 1.0,
                 to_world: Matrix4 | None = None, flip_normals: bool = False, bsdf: BSDF | None = None,
                 emitter: Emitter | None = None,
                 interior: Medium | None = None, exterior: Medium | None = None):
        super().__init__(bsdf=bsdf, emitter=emitter, flip_normals=flip_normals, interior=interior, exterior=exterior)
        matrix, radius = affine("to_world", to_world), positive("radius", radius)
        if p0 is not None or p1 is not None or radius != 1:
            start = finite("p0", START if p0 is None else p0, (3,))
            end = finite("p1", END if p1 is None else p1, (3,))
            matrix = matrix @ along_axis(start.double(), end.double(), radius).to(matrix.dtype)
        self.place(matrix, unit_cylinder())

    p0, p1, radius = None, None, 1.0  # resolved into `to_world`


def along_axis(start: Tensor, end: Tensor, radius: float) -> Tensor:
    """The (4, 4) transform of the unit cylinder to the one between two points, (3,) each, rotated as in Mitsuba."""
    axis = end - start
    if not axis.any():
        raise ValueError(f"p0 and p1 must differ, got {start.tolist()} twice")
    frame = Frame.of(Vec3.of(axis / axis.norm()))
    columns = torch.stack([radius * frame.s.stack(), radius * frame.t.stack(), axis, start], 1)
    return torch.cat([columns, columns.new_tensor([[0.0, 0.0, 0.0, 1.0]])])


def unit_cylinder() -> Triangles:
    """The tessellated cylinder of radius 1 around z from 0 to 1."""
    uv, faces = grid(SECTORS, 1)
    angle, sector = 2 * math.pi * uv[:, 0], math.pi / SECTORS
    radius = sector / math.sin(sector)
    normals = torch.stack([torch.cos(angle), torch.sin(angle), torch.zeros_like(angle)], 1)
    height = torch.nn.functional.pad(uv[:, 1:], (2, 0))
    return Triangles(radius * normals + height, faces, normals, uv)
