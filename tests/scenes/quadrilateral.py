"""A quadrilateral that is not flat, by itself and in files."""

from __future__ import annotations

import functools
import tempfile
from pathlib import Path
from typing import Any

from tests.formats.serialized_files import mesh, serialized
from tests.scenes import texels

# Its normals are not its own.
CORNERS = [[-2.1, -1.9, 0.13], [2.2, -2.0, -0.31], [1.9, 2.3, 0.27], [-2.0, 2.1, -0.22]]
NORMALS = [[-0.31, -0.22, 0.9], [0.33, -0.17, 0.95], [0.21, 0.34, 0.9], [-0.27, 0.19, 1.0]]
TEXCOORDS = [[0.11, 0.23], [1.31, 0.07], [1.17, 1.42], [-0.21, 1.13]]
FACES = [[0, 1, 2], [0, 2, 3]]


def quadrilateral(smooth: bool = True, **attributes: Any) -> dict[str, Any]:
    mesh = {"type": "mesh", "vertex_positions": CORNERS, "vertex_texcoords": TEXCOORDS, "faces": FACES}
    return mesh | ({"vertex_normals": NORMALS} if smooth else {}) | attributes


@functools.cache
def folder() -> tempfile.TemporaryDirectory:
    """Where files of meshes are, until the process ends."""
    return tempfile.TemporaryDirectory()


def coloured_file(faces: bool = True) -> str:
    """The quadrilateral in a PLY file with an attribute of vertices, and perhaps one of faces."""
    path = Path(folder().name) / f"coloured_{faces}.ply"
    columns = "".join(f"property float {name}\n" for name in ("x", "y", "z", "r", "g", "b"))
    header = (f"ply\nformat ascii 1.0\nelement vertex {len(CORNERS)}\n{columns}element face {len(FACES)}\n"
              f"property list uchar int vertex_indices\n{faces * 'property float shine_x'}\nend_header\n")
    colours = 0.2 + 0.6 * texels(1, len(CORNERS), 7)[0]
    rows = [*(p + colour for p, colour in zip(CORNERS, colours.tolist())),
            *([3, *face, 0.3 * face[1]][:4 + faces] for face in FACES)]
    path.write_text(header + "".join(" ".join(map(str, row)) + "\n" for row in rows))
    return str(path)


def mesh_file(suffix: str) -> str:
    """The quadrilateral in a file."""
    path = Path(folder().name) / f"quadrilateral.{suffix}"
    if suffix == "serialized":
        path.write_bytes(serialized(mesh(CORNERS, FACES, double=True, normals=NORMALS, uv=TEXCOORDS)))
        return str(path)

    def lines(prefix: str, rows) -> list[str]:
        return [" ".join([prefix, *map(str, row)]).strip() for row in rows]

    if suffix == "obj":
        text = [*lines("v", CORNERS), *lines("vt", TEXCOORDS), *lines("vn", NORMALS),
                *lines("f", [[f"{k + 1}/{k + 1}/{k + 1}" for k in face] for face in FACES])]
    else:
        columns = "".join(f"property float {name}\n" for name in ("x", "y", "z", "nx", "ny", "nz", "u", "v"))
        header = (f"ply\nformat ascii 1.0\nelement vertex {len(CORNERS)}\n{columns}element face {len(FACES)}\n"
                  "property list uchar int vertex_indices\nend_header")
        text = [header, *lines("", [p + n + uv for p, n, uv in zip(CORNERS, NORMALS, TEXCOORDS)]),
                *lines("", [[3, *face] for face in FACES])]
    path.write_text("\n".join(text) + "\n")
    return str(path)
