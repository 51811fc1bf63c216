"""Triangle meshes from OBJ and PLY files, numbered as Mitsuba numbers them, and PLY files back out."""

from __future__ import annotations

import os
import re
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np

from torch_radbp.io.atomic import replacing

# Lines of an OBJ file that divide it into objects, groups and materials; without them it is read as one mesh.
DIVISIONS = re.compile(rb"^[ \t]*(o|g|s|usemtl|mtllib)\b.*$", re.MULTILINE)
RELATIVE_INDEX = re.compile(rb"^[ \t]*f\b.*[ \t/]-\d", re.MULTILINE)


class MeshArrays(NamedTuple):
    """A triangle mesh in the file's own coordinates."""

    vertices: np.ndarray  # (V, 3) float64
    faces: np.ndarray  # (F, 3) int64
    normals: np.ndarray | None  # (V, 3) float64, as in the file: not normalised
    uv: np.ndarray | None  # (V, 2) float64, as in the file: `flip_tex_coords` is the plugin's business


def read_mesh(path: str | os.PathLike) -> MeshArrays:
    """Reads a mesh; all objects and groups of a file become one, polygons become triangles.

    An OBJ vertex that is used with several normals or uv becomes several vertices, in the order in which the faces
    mention them (as in Mitsuba, so that `vertex_positions` agree); a PLY keeps its vertices and their order. Materials
    named in the file are not read.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: on unknown extensions, unreadable files, meshes without faces, indices out of range, numbers that
            are not finite, and meshes whose triangles all have area 0.
    """
    readers = {".obj": _read_obj, ".ply": _read_ply}
    suffix = Path(path).suffix.lower()
    if suffix not in readers:
        raise ValueError(f"{path}: unknown kind of mesh {suffix!r}; supported: {', '.join(readers)}")
    if not Path(path).is_file():
        raise FileNotFoundError(f"{path}: file not found")
    with open(path, "rb") as file:
        try:
            mesh = readers[suffix](file)
        except Exception as error:  # trimesh raises whatever its parser stumbles over
            raise ValueError(f"{path}: cannot be read as {suffix[1:].upper()}: {error}") from error
    _check(path, mesh)
    return mesh


def write_ply(path: str | os.PathLike, mesh: MeshArrays) -> None:
    """Writes a binary PLY file with the attributes' dtypes, atomically; Mitsuba, trimesh and Blender read it."""
    columns = {"xyz": mesh.vertices, ("nx", "ny", "nz"): mesh.normals, "uv": mesh.uv}
    columns = {names: values for names, values in columns.items() if values is not None}
    kind = "<f8" if mesh.vertices.dtype == np.float64 else "<f4"
    vertices = np.empty(len(mesh.vertices), dtype=[(name, kind) for names in columns for name in names])
    for names, values in columns.items():
        for axis, name in enumerate(names):
            vertices[name] = values[:, axis]
    faces = np.empty(len(mesh.faces), dtype=[("count", "u1"), ("indices", "<i4", (3,))])
    faces["count"], faces["indices"] = 3, mesh.faces
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertices)}",
              *(f"property {'double' if kind == '<f8' else 'float'} {name}" for name in vertices.dtype.names),
              f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header\n"]
    with replacing(path) as temporary:
        temporary.write_bytes("\n".join(header).encode("ascii") + vertices.tobytes() + faces.tobytes())


def _read_obj(file: BinaryIO) -> MeshArrays:
    from trimesh.exchange.obj import load_obj  # a second to import, for scenes with files only

    text = file.read()
    if RELATIVE_INDEX.search(text):
        raise ValueError("relative (negative) vertex indices are not supported; export absolute ones")
    loaded = load_obj(BytesIO(DIVISIONS.sub(b"", text)), skip_materials=True)
    return _in_order_of_use(_arrays(next(iter(loaded.get("geometry", {}).values()), loaded)))


def _read_ply(file: BinaryIO) -> MeshArrays:
    from trimesh.exchange.ply import load_ply  # a second to import, for scenes with files only

    loaded = load_ply(file, fix_texture=False, skip_materials=True)
    elements = loaded["metadata"]["_ply_raw"]
    if "texcoord" in elements.get("face", {}).get("properties", {}):
        raise ValueError("texture coordinates are stored per face; export them per vertex (u, v)")
    return _arrays(loaded)


def _arrays(loaded: dict[str, Any]) -> MeshArrays:
    """What trimesh's loaders return, as arrays of known types."""
    vertices, faces = loaded.get("vertices"), loaded.get("faces")
    if vertices is None or len(vertices) == 0 or faces is None or len(faces) == 0:
        raise ValueError(f"the mesh has {0 if vertices is None else len(vertices)} vertices and no faces")
    normals, uv = loaded.get("vertex_normals"), getattr(loaded.get("visual"), "uv", None)
    return MeshArrays(np.asarray(vertices, dtype=np.float64), _fans(np.asarray(faces, dtype=np.int64)),
                      None if normals is None else np.asarray(normals, dtype=np.float64),
                      None if uv is None else np.asarray(uv, dtype=np.float64))


def _fans(polygons: np.ndarray) -> np.ndarray:
    """(F (k-2), 3) triangles of (F, k) polygons, each a fan around its first corner."""
    fan = [polygons[:, [0, corner, corner + 1]] for corner in range(1, polygons.shape[1] - 1)]
    return np.stack(fan, axis=1).reshape(-1, 3)


def _in_order_of_use(mesh: MeshArrays) -> MeshArrays:
    """The same mesh, vertices numbered as the faces first mention them; those never mentioned are dropped."""
    used, first, inverse = np.unique(mesh.faces, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    taken = [None if values is None else values[used[order]] for values in (mesh.vertices, mesh.normals, mesh.uv)]
    return MeshArrays(taken[0], rank[inverse].reshape(mesh.faces.shape), taken[1], taken[2])


def _check(path: str | os.PathLike, mesh: MeshArrays) -> None:
    count = len(mesh.vertices)
    if mesh.faces.min() < 0 or mesh.faces.max() >= count:
        found = f"{mesh.faces.min()} to {mesh.faces.max()}"
        raise ValueError(f"{path}: faces must index vertices 0 to {count - 1}, got {found}")
    for name, values in zip(("vertices", "faces", "normals", "uv"), mesh, strict=True):
        bad = 0 if values is None else int((~np.isfinite(values)).any(axis=1).sum())
        if bad:
            raise ValueError(f"{path}: {name} must be finite, {bad} of {len(values)} are NaN or infinite")
    corners = mesh.vertices[mesh.faces]
    if not np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).any():
        raise ValueError(f"{path}: all {len(mesh.faces)} triangles are degenerate (area 0)")
