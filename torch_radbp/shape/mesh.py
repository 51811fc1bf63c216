"""Triangle meshes: from files, and from tensors."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_radbp.plugin import BSDF, Emitter, Filename, Matrix4, finite, register
from torch_radbp.shape.surface import Surface, Triangles, affine, transform_normals, transform_points


class Mesh(Surface):
    """Triangles with their vertices as parameters.

    Parameters: `vertex_positions` (V, 3), `vertex_normals` (V, 3) if there are any, `vertex_texcoords` (V, 2) if there are
    any, all in world space; `faces` (F, 3) int64 is a buffer.
    """

    def hold(self, positions: Tensor, faces: Tensor, normals: Tensor | None, texcoords: Tensor | None,
             to_world: Tensor | None) -> None:
        """Checks and stores the mesh; `to_world` is applied once.

        Raises:
            ValueError: if the mesh is empty, refers to vertices it does not have, is not finite, or has no area.
        """
        dtype = torch.get_default_dtype()
        faces = torch.as_tensor(faces).to(torch.int64)
        positions = finite("vertex_positions", positions)
        if positions.ndim != 2 or positions.shape[1:] != (3,):
            raise ValueError(f"vertex_positions must have shape (V, 3), got {tuple(positions.shape)}")
        count = len(positions)
        if faces.ndim != 2 or faces.shape[1:] != (3,) or len(faces) == 0 or count == 0:
            raise ValueError(f"a mesh needs vertices and faces of shape (F, 3), got {count} vertices and faces of shape "
                             f"{tuple(faces.shape)}")
        if faces.min() < 0 or faces.max() >= count:
            raise ValueError(f"faces must index vertices 0 to {count - 1}, got {int(faces.min())} to {int(faces.max())}")
        matrix = affine("to_world", to_world)
        positions = transform_points(matrix, positions.to(dtype))
        edges = positions[faces[:, 1:]] - positions[faces[:, :1]]
        if not (torch.linalg.cross(edges[:, 0], edges[:, 1]).norm(dim=1) > 0).any():
            raise ValueError(f"all {len(faces)} triangles of the mesh are degenerate (area 0)")
        self.freeze("vertex_positions", positions)
        if normals is not None:
            normals = finite("vertex_normals", normals, (count, 3)).to(dtype)
            self.freeze("vertex_normals", transform_normals(matrix, normals))
        if texcoords is not None:
            self.freeze("vertex_texcoords", finite("vertex_texcoords", texcoords, (count, 2)).to(dtype))
        self.has_normals, self.has_texcoords = normals is not None, texcoords is not None
        self.register_buffer("faces", faces)

    def triangles(self) -> Triangles:
        normals = torch.nn.functional.normalize(self.vertex_normals, dim=-1) if self.has_normals else None
        return Triangles(self.vertex_positions, self.faces, normals, self.vertex_texcoords if self.has_texcoords else None)


class FileMesh(Mesh):
    """A mesh read from a file.

    Args:
        filename: the file.
        face_normals: shade flat; else the file's vertex normals are used, or smooth ones if it has none, as in Mitsuba.
        flip_tex_coords: use 1 - v, as Mitsuba does.
    """

    def read(self, filename: str, face_normals: bool, flip_tex_coords: bool, to_world: Tensor | None) -> None:
        from torch_radbp.io.mesh import angle_weighted_normals, read_mesh  # io reads files for every layer above `vec`

        self.filename, self.face_normals, self.flip_tex_coords, self.to_world = (
            filename, face_normals, flip_tex_coords, to_world)
        vertices, faces, normals, uv = read_mesh(filename)
        if flip_tex_coords and uv is not None:
            uv = uv.copy()
            uv[:, 1] = 1.0 - uv[:, 1]
        matrix = affine("to_world", to_world).double()
        vertices = transform_points(matrix, torch.from_numpy(vertices))
        if face_normals:
            normals = None
        elif normals is None:
            normals = torch.from_numpy(angle_weighted_normals(vertices.numpy(), faces))
        else:
            normals = transform_normals(matrix, torch.from_numpy(normals))
        self.hold(vertices, torch.from_numpy(faces), normals, None if uv is None else torch.from_numpy(uv), None)


@register("shape", "obj")
class OBJ(FileMesh):
    """A Wavefront OBJ file. Parameters: see `Mesh`."""

    def __init__(self, *, filename: Filename, face_normals: bool = False, flip_tex_coords: bool = True,
                 to_world: Matrix4 | None = None, flip_normals: bool = False, bsdf: BSDF | None = None,
                 emitter: Emitter | None = None):
        super().__init__(bsdf=bsdf, emitter=emitter, flip_normals=flip_normals)
        self.read(filename, face_normals, flip_tex_coords, to_world)


@register("shape", "ply")
class PLY(FileMesh):
    """A Stanford PLY file. Parameters: see `Mesh`."""

    def __init__(self, *, filename: Filename, face_normals: bool = False, flip_tex_coords: bool = False,
                 to_world: Matrix4 | None = None, flip_normals: bool = False, bsdf: BSDF | None = None,
                 emitter: Emitter | None = None):
        super().__init__(bsdf=bsdf, emitter=emitter, flip_normals=flip_normals)
        self.read(filename, face_normals, flip_tex_coords, to_world)


@register("shape", "mesh")
class TensorMesh(Mesh):
    """A mesh given as tensors, for scenes built in Python. Parameters: see `Mesh`."""

    def __init__(self, *, vertex_positions: Tensor, faces: Tensor, vertex_normals: Tensor | None = None,
                 vertex_texcoords: Tensor | None = None, to_world: Matrix4 | None = None, flip_normals: bool = False,
                 bsdf: BSDF | None = None, emitter: Emitter | None = None):
        super().__init__(bsdf=bsdf, emitter=emitter, flip_normals=flip_normals)
        self.hold(vertex_positions, faces, vertex_normals, vertex_texcoords, to_world)
