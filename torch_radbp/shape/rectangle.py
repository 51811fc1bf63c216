"""The square [-1, 1] x [-1, 1] in the plane z = 0, facing +z."""

from __future__ import annotations

from torch_radbp.plugin import BSDF, Emitter, Matrix4, Medium, register
from torch_radbp.shape.surface import Tessellated, Triangles, grid


@register("shape", "rectangle")
class Rectangle(Tessellated):
    """A rectangle: the canonical square under `to_world`; uv runs from 0 to 1 along x and y.

    Parameters: `to_world` (4, 4).

    Args:
        face_normals: without effect, as in Mitsuba: it is flat.
    """

    whole = True

    def __init__(self, *, face_normals: bool = False, to_world: Matrix4 | None = None, flip_normals: bool = False,
                 bsdf: BSDF | None = None, emitter: Emitter | None = None,
                 interior: Medium | None = None, exterior: Medium | None = None):
        super().__init__(bsdf=bsdf, emitter=emitter, flip_normals=flip_normals, interior=interior, exterior=exterior)
        self.face_normals = face_normals
        uv, faces = grid(1, 1)
        vertices = uv.new_zeros(len(uv), 3)
        vertices[:, :2] = 2 * uv - 1
        self.place(to_world, Triangles(vertices, faces, None, uv))
