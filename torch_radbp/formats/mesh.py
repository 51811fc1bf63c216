"""Reads triangle meshes from OBJ, PLY and serialized files, numbered as in Mitsuba."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from torch_radbp.formats.files import opened, unknown_kind
from torch_radbp.formats.mesh_arrays import MeshArrays
from torch_radbp.formats.obj import read_obj
from torch_radbp.formats.ply import read_ply
from torch_radbp.formats.serialized import read_serialized

READERS = {".obj": read_obj, ".ply": read_ply, ".serialized": read_serialized}


def read_mesh(path: str | os.PathLike, want_normals: bool = True, shape_index: int | None = None) -> MeshArrays:
    """Reads a mesh; all objects and groups of a file become one, polygons become fans of triangles.

    An OBJ vertex that is used with several normals or uv becomes several vertices, in the order in which the faces
    mention them (as in Mitsuba, so that `vertex_positions` agree); a PLY keeps its vertices and their order. Materials
    and colours in the file are not read.

    Args:
        path: the .obj, .ply or .serialized file.
        want_normals: False leaves out the file's normals; then it does not matter whether they are usable.
        shape_index: which mesh of a serialized file, whatever its extension; None: the extension tells the kind of file.

    Raises:
        FileNotFoundError: if there is no such file.
        IsADirectoryError: if it is a folder.
        ValueError: names the file, and the line where there is one, of what is malformed, cut short, out of range or not
            finite; on unknown extensions, meshes without faces, normals without a direction, and meshes whose triangles
            all have area 0.
    """
    suffix, which = Path(path).suffix.lower(), ()
    if shape_index is not None:
        suffix, which = ".serialized", (shape_index,)
    if suffix not in READERS:
        raise ValueError(unknown_kind(path, "mesh", READERS))
    with opened(path) as file:
        mesh = READERS[suffix](file, os.fspath(path), want_normals, *which)
    if _is_degenerate(mesh):
        raise ValueError(f"{path}: all {len(mesh.faces)} triangles are degenerate (area 0)")
    return mesh


def _is_degenerate(mesh: MeshArrays, block: int = 4096) -> bool:
    """True if no triangle has an area; stops at the first block of faces that contains one."""
    for start in range(0, len(mesh.faces), block):
        corners = mesh.vertices[mesh.faces[start:start + block]]
        if np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).any():
            return False
    return True
