"""The cube [-1, 1]^3."""

from __future__ import annotations

import torch

from torch_radbp.plugin import BSDF, Emitter, Matrix4, Medium, register
from torch_radbp.shape.mesh import Mesh

# For each face: its outward normal and the directions of u and v.
FACES = (
    ((0, -1, 0), (0, 0, 1), (1, 0, 0)),
    ((0, 1, 0), (-1, 0, 0), (0, 0, -1)),
    ((1, 0, 0), (0, 1, 0), (0, 0, -1)),
    ((0, 0, 1), (0, 1, 0), (1, 0, 0)),
    ((-1, 0, 0), (0, 1, 0), (0, 0, 1)),
    ((0, 0, -1), (0, -1, 0), (1, 0, 0)),
)


@register("shape", "cube")
class Cube(Mesh):
    """A cube of six faces with their own vertices, normals and uv, numbered as in Mitsuba.

    Args:
        face_normals: leaves `vertex_normals` out, so that faces are shaded flat wherever their vertices move.
    """

    def __init__(self, *, face_normals: bool = False, to_world: Matrix4 | None = None, flip_normals: bool = False,
                 bsdf: BSDF | None = None, emitter: Emitter | None = None,
                 interior: Medium | None = None, exterior: Medium | None = None):
        super().__init__(bsdf=bsdf, emitter=emitter, flip_normals=flip_normals, interior=interior, exterior=exterior)
        self.face_normals = face_normals
        square = torch.tensor([[0.0, 1], [1, 1], [1, 0], [0, 0]])
        positions, normals = [], []
        for face in FACES:
            n, u, v = torch.tensor(face, dtype=torch.get_default_dtype())
            positions.append(n + (2 * square[:, :1] - 1) * u + (2 * square[:, 1:] - 1) * v)
            normals.append(n.expand(4, 3))
        corner = 4 * torch.arange(6)[:, None]
        faces = torch.cat([corner + torch.tensor([0, 1, 2]), corner + torch.tensor([3, 0, 2])])
        self.hold(torch.cat(positions), faces, None if face_normals else torch.cat(normals), square.repeat(6, 1), to_world)
