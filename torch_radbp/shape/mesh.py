"""Triangle meshes: from files, and from tensors."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, ClassVar

import numpy as np
import torch
from torch import Tensor, nn

from torch_radbp.formats.mesh import read_mesh
from torch_radbp.formats.mesh_arrays import MeshArrays
from torch_radbp.formats.trimesh_arrays import arrays_of
from torch_radbp.formats.trimesh_file import read_trimesh
from torch_radbp.plugin import BSDF, Emitter, Filename, Matrix4, Medium, TriangleMesh, finite, register
from torch_radbp.plugin.domain import LARGEST_COORDINATE, POSE, Domain
from torch_radbp.shape.normals import BLOCK, angle_weighted_normals
from torch_radbp.shape.surface import Surface, Triangles, turned
from torch_radbp.tensors.vec import attached
from torch_radbp.texture.mesh_attribute import PREFIXES as ATTRIBUTE_PREFIXES
from torch_radbp.transforms import affine, matrix_inverse, mirrors, transform_normals, transform_points

if TYPE_CHECKING:
    import trimesh


class Mesh(Surface):
    """Triangles with their vertices as parameters.

    Parameters: `vertex_positions` (V, 3); `vertex_normals` (V, 3) and `vertex_texcoords` (V, 2) if the mesh has any;
    `to_world` (4, 4). As in Mitsuba, positions and normals are in world space, under the `to_world` with which the mesh was
    loaded; if `to_world` changes, they move along. `faces` (F, 3) int64 is a buffer. Attributes of vertices and faces, see
    `add_attribute`, are parameters, too.

    Attributes:
        vertex_positions: (V, 3), world space.
        vertex_normals: (V, 3), world space, of any length; if the mesh has any.
        vertex_texcoords: (V, 2) surface coordinates; if the mesh has any.

    Args:
        recompute_normals: shade smoothly, with normals that are not a parameter but are computed from the positions at every
            rendering (`angle_weighted_normals`), with derivatives. Mitsuba does so whenever positions change.
    """

    may_cross_itself = True

    def hold(self, positions: Tensor, faces: Tensor, normals: Tensor | None, texcoords: Tensor | None,
             to_world: Tensor | None, smooth: bool = False, recompute_normals: bool = False) -> None:
        """Checks and stores the mesh, positions and normals before `to_world`; `smooth`: computes normals if none are given.

        Raises:
            ValueError: if the mesh is empty, refers to vertices it does not have, is not finite, or has no area; if normals
                are given and are to be recomputed.
        """
        dtype = torch.get_default_dtype()
        faces = vertex_indices("faces", faces)
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
        positions = positions.to(dtype)
        if to_world is not None:
            positions = finite("vertex_positions in world space", transform_points(matrix.detach(), positions))
        if not has_area(positions.detach(), faces):
            raise ValueError(f"all {len(faces)} triangles of the mesh are degenerate (area 0)")
        self.vertex_count, self.attribute_names = count, ()
        self.freeze("vertex_positions", positions)
        self.recompute_normals = recompute_normals
        if recompute_normals and normals is not None:
            raise ValueError("recompute_normals makes normals of the positions: leave vertex_normals out")
        if normals is not None:
            normals = finite("vertex_normals", normals, (count, 3)).to(dtype)
            if to_world is not None or not isinstance(normals, nn.Parameter):
                normals = transform_normals(matrix.detach(), normals)
            if (normals.detach().norm(dim=1) < 0.5).any():
                raise ValueError("vertex_normals must not be zero: leave them out, or ask for recompute_normals")
        elif smooth and not recompute_normals:
            normals = angle_weighted_normals(positions.detach(), faces)
        if normals is not None:
            self.freeze("vertex_normals", normals)
        if texcoords is not None:
            self.freeze("vertex_texcoords", finite("vertex_texcoords", texcoords, (count, 2)).to(dtype))
        self.has_normals, self.has_texcoords = normals is not None, texcoords is not None
        self.register_buffer("faces", faces)
        self.freeze("to_world", matrix)
        self.register_buffer("loaded_to_world", matrix.detach().clone(), persistent=False)

    def domains(self) -> dict[str, Domain]:
        vector = Domain(shapes=((self.vertex_count, 3),))
        position = vector._replace(low=-LARGEST_COORDINATE, high=LARGEST_COORDINATE)
        rows = {name: len(self.faces) if name.startswith("face_") else self.vertex_count for name in self.attribute_names}
        attributes = {name: Domain(shapes=((count, 1), (count, 3))) for name, count in rows.items()}
        return {"vertex_positions": position, "vertex_normals": vector, "to_world": POSE, **attributes,
                "vertex_texcoords": Domain(shapes=((self.vertex_count, 2),)),
                "faces": Domain(shapes=(("F", 3),), low=0, high=self.vertex_count - 1, is_index=True)}

    def triangles(self) -> Triangles:
        motion = self.motion()
        positions, normals = transform_points(motion, self.vertex_positions), None
        if self.recompute_normals:
            normals = angle_weighted_normals(positions, self.faces)
        elif self.has_normals:
            normals = transform_normals(motion, self.vertex_normals)
        attributes = tuple((name, getattr(self, name)) for name in self.attribute_names)
        return Triangles(positions, self.faces, normals, self.vertex_texcoords if self.has_texcoords else None,
                         attributes=attributes)

    def add_attribute(self, name: str, values: Tensor) -> None:
        """Adds an attribute of vertices or faces for the texture `mesh_attribute`, as the parameter `name`.

        Args:
            name: begins with vertex_ or face_.
            values: (V, 1) or (V, 3) of vertices, (F, 1) or (F, 3) of faces; an `nn.Parameter` of the mesh's dtype and device
                becomes its own.

        Raises:
            ValueError: on another name, one that is taken, another shape, or values that are not finite.
        """
        if not name.startswith(ATTRIBUTE_PREFIXES) or "." in name:
            raise ValueError(f"an attribute must have a name without dots that begins with "
                             f"{' or '.join(ATTRIBUTE_PREFIXES)}, got {name!r}")
        if hasattr(self, name):
            raise ValueError(f"the mesh has {name!r} already")
        self.attribute_names = (*self.attribute_names, name)
        try:
            self.freeze(name, finite(name, values).to(self.vertex_positions))
        except ValueError:
            self.attribute_names = self.attribute_names[:-1]
            raise

    def replace(self, positions: Tensor, faces: Tensor, columns: dict[str, Tensor]) -> None:
        """Replaces vertices and faces; `requires_grad` of the old ones is not kept.

        Args:
            positions: (V, 3), as `vertex_positions`.
            faces: (F, 3).
            columns: `vertex_normals` and `vertex_texcoords`, if the mesh has them, and its attributes, by name.

        Raises:
            ValueError: as for the mesh.
        """
        faces, positions = vertex_indices("faces", faces).to(self.faces.device), finite("vertex_positions", positions)
        if faces.ndim != 2 or faces.shape[1:] != (3,) or not len(faces) or faces.min() < 0 or faces.max() >= len(positions):
            raise ValueError(f"faces must have shape (F, 3) and index vertices 0 to {len(positions) - 1}, got shape "
                             f"{tuple(faces.shape)}")
        if not has_area(positions.detach(), faces):
            raise ValueError(f"all {len(faces)} triangles of the mesh are degenerate (area 0)")
        self.vertex_count, self.faces = len(positions), faces
        for name, values in {"vertex_positions": positions, **columns}.items():
            self.freeze(name, values.detach().clone())

    def motion(self) -> Tensor:
        """The (4, 4) transform from the pose at loading to the current one; exactly the identity while they are equal."""
        motion = (self.to_world.double() @ matrix_inverse(self.loaded_to_world.double())).to(self.to_world.dtype)
        rests = (self.to_world.detach() == self.loaded_to_world).all()
        return torch.where(rests, attached(torch.eye(4, dtype=motion.dtype, device=motion.device), motion), motion)


def has_area(positions: Tensor, faces: Tensor) -> bool:
    """True if any triangle has an area; stops at the first block of faces that contains one."""
    blocks = (positions[block].unbind(1) for block in faces.split(BLOCK))
    return any(bool(torch.linalg.cross(second - first, third - first).any()) for first, second, third in blocks)


def vertex_indices(name: str, values: Tensor) -> Tensor:
    """Converts indices of vertices to int64.

    Raises:
        ValueError: if they are no integers, or cannot be.
    """
    values = torch.as_tensor(values)
    if values.is_complex() or values.dtype == torch.bool:
        raise ValueError(f"{name} must be indices of vertices, integers, got {values.dtype}")
    if values.is_floating_point() and not torch.equal(values, values.round()):
        raise ValueError(f"{name} must be indices of vertices, integers, got fractions")
    return values.to(torch.int64)


class FileMesh(Mesh):
    """Base class of meshes that are read from a file.

    Args:
        filename: the file.
        face_normals: shade flat; else the file's vertex normals are used, or smooth ones if it has none, as in Mitsuba.
        flip_tex_coords: use 1 - v, as Mitsuba does.
        recompute_normals: shade smoothly, with normals that are computed from the positions at every rendering, instead of
            those of the file.
        shape_index: which mesh of a serialized file; None: the file is of another kind.

    Raises:
        ValueError: if both `face_normals` and `recompute_normals` are asked for.
    """

    def read(self, filename: str, face_normals: bool, flip_tex_coords: bool, recompute_normals: bool,
             to_world: Tensor | None, shape_index: int | None = None) -> None:
        if face_normals and recompute_normals:
            raise ValueError("face_normals shades flat and recompute_normals shades smooth: choose one")
        self.filename, self.face_normals, self.flip_tex_coords = filename, face_normals, flip_tex_coords
        arrays = read_mesh(filename, not (face_normals or recompute_normals), shape_index)
        vertices, faces, normals, uv, attributes = arrays
        if flip_tex_coords and uv is not None:
            uv = uv.copy()
            uv[:, 1] = 1.0 - uv[:, 1]
        if normals is not None and not (has := normals.any(axis=1)).all():
            made = angle_weighted_normals(torch.from_numpy(vertices), torch.from_numpy(faces)).numpy()
            normals = np.where(has[:, None], normals, made)
        normals, uv = (None if values is None else torch.from_numpy(values) for values in (normals, uv))
        self.hold(torch.from_numpy(vertices), torch.from_numpy(faces), normals, uv, to_world, not face_normals,
                  recompute_normals)
        for name, values in attributes.items():
            self.add_attribute(name, torch.from_numpy(values))


@register("shape", "obj")
class OBJ(FileMesh):
    """A mesh from a Wavefront OBJ file."""

    def __init__(self, *, filename: Filename, face_normals: bool = False, flip_tex_coords: bool = True,
                 recompute_normals: bool = False, to_world: Matrix4 | None = None, flip_normals: bool = False,
                 bsdf: BSDF | None = None, emitter: Emitter | None = None,
                 interior: Medium | None = None, exterior: Medium | None = None):
        super().__init__(bsdf=bsdf, emitter=emitter, flip_normals=flip_normals, interior=interior, exterior=exterior)
        self.read(filename, face_normals, flip_tex_coords, recompute_normals, to_world)


@register("shape", "ply")
class PLY(FileMesh):
    """A mesh from a Stanford PLY file."""

    def __init__(self, *, filename: Filename, face_normals: bool = False, flip_tex_coords: bool = False,
                 recompute_normals: bool = False, to_world: Matrix4 | None = None, flip_normals: bool = False,
                 bsdf: BSDF | None = None, emitter: Emitter | None = None,
                 interior: Medium | None = None, exterior: Medium | None = None):
        super().__init__(bsdf=bsdf, emitter=emitter, flip_normals=flip_normals, interior=interior, exterior=exterior)
        self.read(filename, face_normals, flip_tex_coords, recompute_normals, to_world)


@register("shape", "mesh")
class TensorMesh(Mesh):
    """A mesh given as tensors, as a mesh of trimesh, or as a file that trimesh reads.

    Of trimesh and files (STL, OFF, 3MF, DAE, GLB, ... by their extension) surface coordinates, normals that the mesh holds
    (without any it is flat), attributes and colours (`vertex_color` or `face_color`) are read. Unless a `bsdf` is given, so
    are the material and what it emits, as of glTF; without a material and colours it is grey. Several meshes become one, and
    have to have one material then; a `trimesh.Scene` that stands in a scene by itself becomes a shape for each of its nodes.
    OBJ and PLY files are read by the shapes `obj` and `ply`.

    Args:
        vertex_positions: (V, 3).
        faces: (F, 3) integers, the corners of each triangle, counter-clockwise as seen from outside.
        vertex_normals: (V, 3), of any length; without them the mesh is flat, unless `recompute_normals`.
        vertex_texcoords: (V, 2) surface coordinates, which bitmaps read.
        mesh: a `trimesh.Trimesh` or `trimesh.Scene` instead of these four.
        filename: a file instead of them.
        recompute_normals: shade smoothly, with normals that are computed from the positions at every rendering, instead of
            those of trimesh and files.
        to_world: (4, 4) transform of positions and normals. One that mirrors turns a mesh of tensors inside out; meshes of
            trimesh and files face outwards still, as in trimesh.

    Raises:
        ValueError: if the mesh is given in none or several of the three ways, or is none.
        ImportError: if trimesh needs another package for a file; the message names it.
    """

    of_trimesh: ClassVar[Callable[[trimesh.Trimesh | trimesh.Scene], TensorMesh]]  # set by `torch_radbp.io.trimesh_shape`

    def __init__(self, *, vertex_positions: Tensor | None = None, faces: Tensor | None = None,
                 vertex_normals: Tensor | None = None, vertex_texcoords: Tensor | None = None,
                 mesh: TriangleMesh | None = None, filename: Filename | None = None, recompute_normals: bool = False,
                 to_world: Matrix4 | None = None, flip_normals: bool = False, bsdf: BSDF | None = None,
                 emitter: Emitter | None = None,
                 interior: Medium | None = None, exterior: Medium | None = None):
        super().__init__(bsdf=bsdf, emitter=emitter, flip_normals=flip_normals, interior=interior, exterior=exterior)
        tensors = {"vertex_positions": vertex_positions, "faces": faces, "vertex_normals": vertex_normals,
                   "vertex_texcoords": vertex_texcoords}
        given = [name for name, value in {**tensors, "mesh": mesh, "filename": filename}.items() if value is not None]
        if given not in (["mesh"], ["filename"]) and (vertex_positions is None or faces is None or {*given} - {*tensors}):
            raise ValueError("a mesh needs vertex_positions and faces, or a mesh of trimesh, or a filename, got "
                             f"{', '.join(given) or 'none of them'}")
        if vertex_positions is not None:
            self.hold(vertex_positions, faces, vertex_normals, vertex_texcoords, to_world,
                      recompute_normals=recompute_normals)
            return
        arrays = mesh if isinstance(mesh, MeshArrays) else arrays_of(read_trimesh(filename) if mesh is None else mesh)
        normals, uv = (None if values is None else torch.from_numpy(values) for values in (arrays.normals, arrays.uv))
        corners = torch.from_numpy(arrays.faces)
        self.hold(torch.from_numpy(arrays.vertices), turned(corners) if mirrors(affine("to_world", to_world)) else corners,
                  None if recompute_normals else normals, uv, to_world, recompute_normals=recompute_normals)
        for name, values in arrays.attributes.items():
            self.add_attribute(name, torch.from_numpy(values))
