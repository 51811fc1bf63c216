"""The containers of glTF: JSON files, and GLB files that hold JSON and a buffer."""

from __future__ import annotations

import json
import os
import struct
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from torch_radbp.formats.files import opened
from torch_radbp.plugin import SceneError

MAGIC, VERSION = b"glTF", 2
JSON_CHUNK, BINARY_CHUNK = b"JSON", b"BIN\0"
LONGEST_JSON = 2**28  # bytes; its objects take up to 20 times as many
HEADER, CHUNK = struct.Struct("<4sII"), struct.Struct("<I4s")


class Container(NamedTuple):
    """The JSON document and the binary buffer of a glTF file."""

    document: dict[str, Any]
    binary: bytes | None  # the buffer inside a GLB file


def read_container(path: str | os.PathLike) -> Container:
    """The JSON of a `.gltf` or `.glb` file, and the buffer that comes with it.

    Raises:
        SceneError: if the file cannot be read, is damaged or cut short, or its JSON is no object or too long.
    """
    name = os.fspath(path)
    try:
        with opened(path) as file:
            begin = file.read(len(MAGIC))
            file.seek(0)
            if begin == MAGIC:
                return _from_chunks(file, name)
            if Path(path).suffix.lower() == ".glb":
                raise SceneError(f"{name}: a GLB file begins with {MAGIC!r}, this one with {begin!r}")
            _check_json(os.fstat(file.fileno()).st_size, name)
            return Container(parse_json(file.read(), name), None)
    except OSError as error:
        raise SceneError(str(error)) from error


def _check_json(length: int, file: str) -> None:
    """Raises SceneError if a JSON document is too long to be read."""
    if length > LONGEST_JSON:
        raise SceneError(f"{file}: its JSON has {length} bytes, more than {LONGEST_JSON}; keep buffers in files of their "
                         "own")


def _from_chunks(source: BinaryIO, file: str) -> Container:
    """Reads the chunks of a GLB file; unknown kinds are skipped, as the specification asks."""
    held = os.fstat(source.fileno()).st_size
    if held < HEADER.size:
        raise SceneError(f"{file}: cut short, a GLB file has a header of {HEADER.size} bytes, this one {held}")
    _, version, length = HEADER.unpack(source.read(HEADER.size))
    if version != VERSION:
        raise SceneError(f"{file}: GLB version {version} is not supported; supported: {VERSION}")
    if length > held:
        raise SceneError(f"{file}: cut short, its header promises {length} bytes, it has {held}")
    chunks: dict[bytes, bytes] = {}
    start = HEADER.size
    while start + CHUNK.size <= length:
        size, kind = CHUNK.unpack(source.read(CHUNK.size))
        start += CHUNK.size
        if start + size > length:
            raise SceneError(f"{file}: cut short, its chunk {kind!r} at byte {start} has {size} bytes, but the file only "
                             f"{length - start} more")
        if kind == JSON_CHUNK:
            _check_json(size, file)
        if kind in (JSON_CHUNK, BINARY_CHUNK) and kind not in chunks:
            chunks[kind] = source.read(size)
        start += size
        source.seek(start)
    if JSON_CHUNK not in chunks:
        raise SceneError(f"{file}: it has no chunk of JSON, which describes the scene")
    return Container(parse_json(chunks[JSON_CHUNK], file), chunks.get(BINARY_CHUNK))


def parse_json(content: bytes, file: str) -> dict[str, Any]:
    """Parses a JSON document that is an object; numbers that are not finite are refused.

    Raises:
        SceneError: names the file and the line.
    """
    def refuse(word: str) -> None:
        raise SceneError(f"{file}: its JSON has the value {word}, which JSON does not allow")

    try:
        document = json.loads(content.decode("utf-8-sig"), parse_constant=refuse)
    except UnicodeDecodeError as error:
        raise SceneError(f"{file}: its JSON is not UTF-8: byte {error.start} cannot be decoded") from error
    except json.JSONDecodeError as error:
        raise SceneError(f"{file}, line {error.lineno}: not well-formed JSON: {error.msg} (column {error.colno})") from error
    except RecursionError as error:
        raise SceneError(f"{file}: its JSON is nested too deep") from error
    except SceneError:
        raise
    except ValueError as error:  # an integer of more digits than Python reads
        raise SceneError(f"{file}: not well-formed JSON: {error}") from error
    if not isinstance(document, dict):
        raise SceneError(f"{file}: its JSON must be an object, got a {type(document).__name__}")
    return document


def glb(document: dict[str, Any], binary: bytes) -> bytes:
    """The bytes of a GLB file with a document and its buffer."""
    text = json.dumps(document, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    binary += b"\0" * (-len(binary) % 4)
    chunks = CHUNK.pack(len(text), JSON_CHUNK) + text
    if binary:
        chunks += CHUNK.pack(len(binary), BINARY_CHUNK) + binary
    return HEADER.pack(MAGIC, VERSION, HEADER.size + len(chunks)) + chunks
