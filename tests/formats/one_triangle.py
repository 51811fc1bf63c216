"""Mesh files of one triangle, whole or spoiled."""

from __future__ import annotations

import struct

CORNERS = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"  # three lines
HEADER = """ply
format {format} 1.0
element vertex 3
property float x
property float y
property float z
{more}element face {faces}
property list {count} int vertex_indices
end_header
"""


def ply(body, format="ascii", more="", faces=1, count="uchar"):
    header = HEADER.format(format=format, more=more, faces=faces, count=count)
    return header.encode() + (body if isinstance(body, bytes) else body.encode())


POINTS = "0 0 0\n1 0 0\n0 1 0\n"  # lines 10 to 12 of a file without further properties
NORMALS = "property float nx\nproperty float ny\nproperty float nz\n"
LITTLE, BIG = "binary_little_endian", "binary_big_endian"
BINARY = struct.pack("<9f", 0, 0, 0, 1, 0, 0, 0, 1, 0)
