"""Writes serialized meshes, as Mitsuba 0.5 wrote them, for tests of the reader."""

from __future__ import annotations

import struct
import zlib
from typing import Any

import numpy as np

FLAGS = {"normals": 0x1, "uv": 0x2, "colours": 0x8}


def mesh(vertices: Any, faces: Any, version: int = 4, double: bool = False, flags: int = 0, name: str = "a mesh",
         **tables: Any) -> bytes:
    """One mesh with its header; `tables`: normals, uv, colours. `flags` are set beside those of the tables."""
    for key in tables:
        flags |= FLAGS[key]
    content = struct.pack("<I", flags | (0x2000 if double else 0x1000))
    content += (name.encode() + b"\0") * (version == 4) + struct.pack("<QQ", len(vertices), len(faces))
    for key in ("vertices", *FLAGS):
        if key in tables or key == "vertices":
            content += np.asarray(tables.get(key, vertices), "<f8" if double else "<f4").tobytes()
    return struct.pack("<HH", 0x041C, version) + zlib.compress(content + np.asarray(faces, "<u4").tobytes())


def serialized(*meshes: bytes) -> bytes:
    """A file of meshes of one version."""
    version, = struct.unpack_from("<H", meshes[0], 2)
    offsets = np.cumsum([0, *map(len, meshes)])[:-1]
    return b"".join(meshes) + offsets.astype("<u8" if version == 4 else "<u4").tobytes() + struct.pack("<I", len(meshes))
