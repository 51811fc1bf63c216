"""Meshes in Mitsuba's own compressed format."""

from __future__ import annotations

from torch_radbp.plugin import BSDF, Emitter, Filename, Matrix4, Medium, integer, register
from torch_radbp.shape.mesh import FileMesh


@register("shape", "serialized")
class Serialized(FileMesh):
    """One mesh of a file in Mitsuba 0.5's "serialized" format.

    Args:
        shape_index: which of the file's meshes, from 0.
    """

    def __init__(self, *, filename: Filename, shape_index: int = 0, face_normals: bool = False,
                 recompute_normals: bool = False, to_world: Matrix4 | None = None, flip_normals: bool = False,
                 bsdf: BSDF | None = None, emitter: Emitter | None = None,
                 interior: Medium | None = None, exterior: Medium | None = None):
        super().__init__(bsdf=bsdf, emitter=emitter, flip_normals=flip_normals, interior=interior, exterior=exterior)
        self.shape_index = integer("shape_index", shape_index, 0)
        self.read(filename, face_normals, False, recompute_normals, to_world, self.shape_index)
