"""Reads and writes Stanford PLY files: ascii and binary of both byte orders.

An own reader, since trimesh's is silent (files cut short load with the vertices that are there) and takes 0.8 s and 303 MB
for a million triangles where this one takes 0.12 s and 113 MB (`python -m benchmarks.mesh_files`). As in Mitsuba, a file
longer than its header says is an error. What is left out or repaired is told.

Reference: Greg Turk 1994, "The PLY Polygon File Format".
"""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import BinaryIO

import numpy as np

from torch_radbp.formats.atomic import replacing
from torch_radbp.formats.leniency import Repairs
from torch_radbp.formats.mesh_arrays import (
    FEW_CORNERS,
    MeshArrays,
    fans,
    usable_normals,
    usable_positions,
    usable_uv,
    used_by,
)
from torch_radbp.formats.ply_ascii import AsciiTables
from torch_radbp.formats.ply_attributes import attributes_in, linear_colours, property_names
from torch_radbp.formats.ply_binary import BinaryTables
from torch_radbp.formats.ply_header import Header, read_header

CORNERS = ("vertex_index", "vertex_indices")
POSITION, NORMAL = ("x", "y", "z"), ("nx", "ny", "nz")
UV = (("u", "v"), ("s", "t"), ("texture_u", "texture_v"))


def read_ply(file: BinaryIO, place: str, want_normals: bool = True) -> MeshArrays:
    """The mesh in a PLY file, vertices in the file's order.

    Normals are the properties nx, ny, nz, texture coordinates u, v or s, t or texture_u, texture_v; attributes are those of
    `ply_attributes`, colours that are integers in sRGB. Other properties and other elements are not used.

    Args:
        file: opened in binary mode.
        place: its name, for messages.
        want_normals: False leaves out the file's normals, whatever they are.

    Raises:
        ValueError: names the file and the line (ascii) or row (binary) of what is malformed, cut short or out of range.
    """
    header = read_header(file, place)
    corner_list = _check_elements(header, place)
    body = BinaryTables(file.read(), header.order, place) if header.order else AsciiTables(file, header.lines + 1, place)
    for element in header.elements:
        if element.name == "vertex":
            columns = body.columns(element)
        elif element.name == "face":
            corners, counts, of_faces = body.lists(element, corner_list)
        else:
            body.lists(element, None)
    body.finish()
    mesh = _mesh(columns, corners, counts, want_normals, body.where, place)
    vertex, face = ({p.name: p.kind for p in element.properties} for name in ("vertex", "face")
                    for element in header.elements if element.name == name)
    return mesh._replace(attributes={**_attributes("vertex", columns, vertex, body.where),
                                     **_attributes("face", of_faces, face, body.where, (counts - 2).clip(0))})


def _attributes(element: str, columns: dict[str, np.ndarray], kinds: dict[str, str], where: Callable[[str, int], str],
                triangles: np.ndarray | None = None) -> dict[str, np.ndarray]:
    """The attributes of an element, (rows, 1 or 3) each; for polygons one row for each triangle.

    One that has values that are not finite is left out. `kinds`: of the properties, as numpy writes them.
    """
    attributes = {}
    for name, channels in attributes_in(columns).items():
        values = np.stack([columns[channel].astype(np.float64) for channel in channels], axis=1)
        if name == "color" or name.endswith("_color"):
            values = linear_colours(values, [kinds[channel] for channel in channels])
        bad = ~np.isfinite(values).all(axis=1)
        if bad.any():
            with Repairs() as repairs:
                repairs.add_rows(np.flatnonzero(bad).tolist(), lambda row: where(element, row),
                                 f"the attribute {element}_{name} is left out: it is not finite")
            continue
        attributes[f"{element}_{name}"] = values if triangles is None else np.repeat(values, triangles, axis=0)
    return attributes


def _check_elements(header: Header, place: str) -> str:
    """Checks that vertices and faces are there, and returns the name of the list of a face's corners.

    Raises:
        ValueError: if vertices or faces are missing, or lack what is needed, or have what is not supported.
    """
    elements = {element.name: element for element in header.elements}
    for name in ("vertex", "face"):
        if name not in elements:
            raise ValueError(f"{place}: the header has no element {name!r}; supported are meshes of element vertex (x, y, "
                             f"z) and element face (list vertex_indices), got {', '.join(elements) or 'none'}")
    vertex, face = elements["vertex"], elements["face"]
    scalars = [p.name for p in vertex.properties if p.count is None]
    if len(scalars) < len(vertex.properties):
        raise ValueError(f"{place}: lists are not supported in element vertex")
    for names in (POSITION, NORMAL, *UV):
        missing = [name for name in names if name not in scalars]
        if missing and (names == POSITION or len(missing) < len(names)):
            raise ValueError(f"{place}: element vertex lacks {', '.join(missing)} of {', '.join(names)}")
    lists = [p.name for p in face.properties if p.count is not None]
    if "texcoord" in lists:
        raise ValueError(f"{place}: texture coordinates are stored per face; export them per vertex (u, v)")
    present = [name for name in CORNERS if name in lists]
    if len(present) != 1:
        raise ValueError(f"{place}: element face needs one list of integers called {' or '.join(CORNERS)}, got "
                         f"{', '.join(lists) or 'no list'}")
    return present[0]


def _mesh(columns: dict[str, np.ndarray], corners: np.ndarray, counts: np.ndarray, want_normals: bool,
          where: Callable[[str, int], str], place: str) -> MeshArrays:
    """The mesh from columns of vertices, all polygons' corners, and the number of corners of each."""
    def stacked(names: tuple[str, ...]) -> np.ndarray | None:
        return np.stack([columns[name].astype(np.float64) for name in names], axis=1) if names[0] in columns else None

    vertices, normals = stacked(POSITION), stacked(NORMAL) if want_normals else None
    uv = stacked(next((names for names in UV if names[0] in columns), UV[0]))
    if len(vertices) == 0 or len(counts) == 0:
        raise ValueError(f"{place}: the mesh has {len(vertices)} vertices and {len(counts) or 'no'} faces")
    bad = (corners < 0) | (corners >= len(vertices)) | (corners % 1 != 0)
    if bad.any():
        row = int(np.searchsorted(np.cumsum(counts), np.argmax(bad), side="right"))
        raise ValueError(f"{where('face', row)}: faces must index vertices 0 to {len(vertices) - 1}, got "
                         f"{corners[np.argmax(bad)]:.17g}")
    few = counts < 3
    if few.any():
        with Repairs() as repairs:
            repairs.add_rows(np.flatnonzero(few).tolist(), lambda row: where("face", row), FEW_CORNERS)
        corners, counts = corners[np.repeat(~few, counts)], counts[~few]
    if len(counts) == 0:
        raise ValueError(f"{place}: the mesh has no face of 3 corners or more")
    faces = fans(corners.astype(np.int64), counts)
    used = used_by(faces, len(vertices))

    def place_of(row: int) -> str:
        return where("vertex", row)

    return MeshArrays(usable_positions(vertices, used, place_of), faces,
                      None if normals is None else usable_normals(normals, used, place_of),
                      None if uv is None else usable_uv(uv, used, place_of))


def write_ply(path: str | os.PathLike, mesh: MeshArrays) -> None:
    """Writes a binary PLY file with the attributes' dtypes, atomically; Mitsuba, trimesh and Blender read it."""
    columns = {"xyz": mesh.vertices, ("nx", "ny", "nz"): mesh.normals, "uv": mesh.uv}
    columns = {names: values for names, values in columns.items() if values is not None}
    kind = "<f8" if mesh.vertices.dtype == np.float64 else "<f4"
    of_faces: dict[tuple[str, ...], np.ndarray] = {}
    for name, values in mesh.attributes.items():
        element, _, attribute = name.partition("_")
        (columns if element == "vertex" else of_faces)[property_names(attribute, values.shape[1])] = values

    def table(rows: int, columns: dict, fields: list) -> np.ndarray:
        made = np.empty(rows, dtype=[*fields, *((name, kind) for names in columns for name in names)])
        for names, values in columns.items():
            for axis, name in enumerate(names):
                made[name] = values[:, axis]
        return made

    def properties(columns: dict) -> list[str]:
        return [f"property {'double' if kind == '<f8' else 'float'} {name}" for names in columns for name in names]

    vertices = table(len(mesh.vertices), columns, [])
    faces = table(len(mesh.faces), of_faces, [("count", "u1"), ("indices", "<i4", (3,))])
    faces["count"], faces["indices"] = 3, mesh.faces
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertices)}", *properties(columns),
              f"element face {len(faces)}", "property list uchar int vertex_indices", *properties(of_faces), "end_header\n"]
    with replacing(path) as temporary:
        temporary.write_bytes("\n".join(header).encode("ascii") + vertices.tobytes() + faces.tobytes())
