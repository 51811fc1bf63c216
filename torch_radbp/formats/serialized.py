"""Reads serialized meshes, the compressed format of Mitsuba: versions 3 and 4.

A file holds one mesh or several, each a header of two 16-bit numbers and a stream that zlib has compressed: flags, a name
(version 4), the numbers of vertices and triangles, and the tables. At the end of the file are the offsets of all meshes (64
bits each in version 4, 32 in version 3) and their number.

Reference: the format's description in the documentation of Mitsuba 3, "Serialized mesh loader".
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from typing import BinaryIO

import numpy as np

from torch_radbp.formats.mesh_arrays import MeshArrays, check_finite, usable_normals, usable_positions, usable_uv, used_by

MAGIC, VERSIONS = 0x041C, (3, 4)
HEADER = struct.Struct("<HH")
# What the mesh has.
NORMALS, UV, COLOURS, FACE_NORMALS, SINGLE, DOUBLE = 0x1, 0x2, 0x8, 0x10, 0x1000, 0x2000
FLAGS = NORMALS | UV | COLOURS | FACE_NORMALS | SINGLE | DOUBLE
LONGEST_NAME = 1 << 12
BLOCK = 1 << 16  # bytes inflated at a time
GREATEST_RATIO = 1032  # of what zlib inflates to what it reads


def read_serialized(file: BinaryIO, place: str, want_normals: bool = True, shape_index: int = 0) -> MeshArrays:
    """One mesh of a serialized file, vertices in the file's order; its colours are the attribute `vertex_color`.

    The flag that asks for flat faces is without effect, as in Mitsuba: `face_normals` says so.

    Args:
        file: opened in binary mode.
        place: its name, for messages.
        want_normals: False leaves out the file's normals, whatever they are.
        shape_index: which mesh, from 0.

    Raises:
        ValueError: names the file, and the vertex or face, of what is malformed, cut short, out of range or not finite.
    """
    data = memoryview(file.read())
    version = version_of(data, place)
    start = 0 if shape_index == 0 else offset_of(data, version, shape_index, place)
    place = f"{place}, mesh {shape_index}"
    version = version_of(data[start:], place)
    stream = Inflated(data[start + HEADER.size:], place)
    flags, = struct.unpack("<I", stream.take(4, "its flags"))
    if flags & ~FLAGS or flags & SINGLE and flags & DOUBLE:
        raise ValueError(f"{place}: its flags 0x{flags:x} are none of the format; is the file damaged?")
    if version == 4:
        stream.name()
    vertex_count, face_count = struct.unpack("<QQ", stream.take(16, "its numbers of vertices and faces"))
    if not 0 < vertex_count <= 0xFFFFFFFF or face_count == 0:
        raise ValueError(f"{place}: the mesh has {vertex_count} vertices and {face_count or 'no'} faces")
    present = {"vertices": True, "normals": flags & NORMALS, "uv": flags & UV, "colours": flags & COLOURS}
    tables = {name: stream.table(name, vertex_count, 2 if name == "uv" else 3, "<f8" if flags & DOUBLE else "<f4")
              for name, is_there in present.items() if is_there}
    faces = stream.table("faces", face_count, 3, "<u4")
    stream.finish()
    return _checked(tables, faces, want_normals, lambda element, row: f"{place}, {element} {row} (from 0)")


def _checked(tables: dict[str, np.ndarray], faces: np.ndarray, want_normals: bool,
             where: Callable[[str, int], str]) -> MeshArrays:
    """The mesh from tables of vertices, (V, 2 or 3) each, and faces, (F, 3), after checks; `where` names places."""
    tables = {name: values.astype(np.float64) for name, values in tables.items() if name != "normals" or want_normals}
    bad, last = faces >= len(tables["vertices"]), len(tables["vertices"]) - 1
    if bad.any():
        row = int(np.argmax(bad.any(axis=1)))
        raise ValueError(f"{where('face', row)}: faces must index vertices 0 to {last}, got {int(faces[row].max())}")
    used = used_by(faces, last + 1)
    for name, usable in (("vertices", usable_positions), ("normals", usable_normals), ("uv", usable_uv)):
        if name in tables:
            tables[name] = usable(tables[name], used, lambda row: where("vertex", row))
    if "colours" in tables:
        check_finite("colours", tables["colours"], lambda row: where("vertex", row))
    colours = {"vertex_color": tables["colours"]} if "colours" in tables else {}
    return MeshArrays(tables["vertices"], faces.astype(np.int64), tables.get("normals"), tables.get("uv"), colours)


def version_of(data: memoryview, place: str) -> int:
    """The format version in the header of a mesh."""
    if len(data) < HEADER.size:
        raise ValueError(f"{place}: cut short, a mesh begins with {HEADER.size} bytes, got {len(data)}")
    magic, version = HEADER.unpack_from(data)
    if magic != MAGIC:
        raise ValueError(f"{place}: a serialized mesh begins with 0x{MAGIC:04x}, got 0x{magic:04x}")
    if version not in VERSIONS:
        raise ValueError(f"{place}: the version must be {' or '.join(map(str, VERSIONS))}, got {version}")
    return version


def offset_of(data: memoryview, version: int, shape_index: int, place: str) -> int:
    """The byte offset of a mesh, from the table at the end of the file."""
    size = 8 if version == 4 else 4
    count = int.from_bytes(data[-4:], "little")
    table = len(data) - 4 - size * count
    if count == 0 or table < HEADER.size:
        raise ValueError(f"{place}: the table of its meshes is damaged or cut short, it has {count} of them in {len(data)} "
                         f"bytes")
    if shape_index >= count:
        raise ValueError(f"{place}: shape_index must be from 0 to {count - 1}, got {shape_index}")
    offset = int.from_bytes(data[table + size * shape_index:][:size], "little")
    if offset > table - HEADER.size:
        raise ValueError(f"{place}: the table of its meshes is damaged, mesh {shape_index} begins at byte {offset} of "
                         f"{len(data)}")
    return offset


class Inflated:
    """A stream that inflates zlib's bytes as they are read.

    Args:
        data: the compressed bytes; what follows after their end is not looked at.
        place: the file and mesh, for messages.
    """

    def __init__(self, data: memoryview, place: str):
        self.data, self.place, self.at = data, place, 0
        self.inflater, self.ready = zlib.decompressobj(), bytearray()

    def fill(self, size: int) -> None:
        """Inflates until `size` bytes are ready, or the stream ends."""
        while len(self.ready) < size and self.at < len(self.data) and not self.inflater.eof:
            try:
                self.ready += self.inflater.decompress(self.data[self.at:self.at + BLOCK])
            except zlib.error as error:
                raise ValueError(f"{self.place}: the compressed data is damaged ({error})") from error
            self.at += BLOCK

    def take(self, size: int, what: str) -> bytes:
        """Reads the next bytes; `what` names them in errors."""
        if size <= len(self.ready) + GREATEST_RATIO * (len(self.data) - self.at):  # else there cannot be as many
            self.fill(size)
        if len(self.ready) < size:
            raise ValueError(f"{self.place}: cut short, it ends in {what}, which need {size} bytes")
        content = bytes(self.ready[:size])
        del self.ready[:size]
        return content

    def table(self, name: str, rows: int, columns: int, kind: str) -> np.ndarray:
        """Reads a table of (rows, columns) numbers."""
        content = self.take(rows * columns * np.dtype(kind).itemsize, f"its {name} ({rows} rows)")
        return np.frombuffer(content, kind).reshape(rows, columns)

    def name(self) -> None:
        """Skips the name of the mesh, a text that ends with a zero byte."""
        self.fill(LONGEST_NAME)
        end = self.ready.find(b"\0", 0, LONGEST_NAME)
        if end < 0:
            raise ValueError(f"{self.place}: its name has no end within {LONGEST_NAME} bytes")
        del self.ready[:end + 1]

    def finish(self) -> None:
        """Raises ValueError if bytes are left, or the checksum at the end is missing or wrong."""
        self.fill(1)
        if self.ready:
            raise ValueError(f"{self.place}: more follows after its faces")
        if not self.inflater.eof:
            raise ValueError(f"{self.place}: cut short, the end of the compressed data is missing")
