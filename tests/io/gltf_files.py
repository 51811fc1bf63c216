"""glTF files put together by hand, without the package's writer."""

from __future__ import annotations

import base64
import io
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

COMPONENTS = {"int8": 5120, "uint8": 5121, "int16": 5122, "uint16": 5123, "uint32": 5125, "float32": 5126}
TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}
SQUARE = [[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]  # seen from +z
SQUARE_UV = [[0, 1], [1, 1], [1, 0], [0, 0]]  # the image stands upright
SQUARE_FACES = [0, 1, 2, 0, 2, 3]


class GltfFile:
    """A document with one buffer, which tests fill and then spoil."""

    def __init__(self) -> None:
        self.binary = b""
        self.document: dict[str, Any] = {"asset": {"version": "2.0"}, "buffers": [{}], "bufferViews": [], "accessors": [],
                                         "meshes": [], "nodes": [], "scenes": [{"nodes": []}], "scene": 0}

    def view(self, content: bytes, **more) -> int:
        self.binary += b"\0" * (-len(self.binary) % 4)
        number = self.add("bufferViews", buffer=0, byteOffset=len(self.binary), byteLength=len(content), **more)
        self.binary += content
        return number

    def array(self, values, dtype="float32", **more) -> int:
        """An accessor."""
        values = np.asarray(values, dtype=dtype)
        values = values[:, None] if values.ndim == 1 else values
        self.document["accessors"].append({"bufferView": self.view(values.tobytes()), "componentType": COMPONENTS[dtype],
                                           "count": len(values), "type": TYPES[values.shape[1]], **more})
        return len(self.document["accessors"]) - 1

    def add(self, kind: str, **entries) -> int:
        """An object of a list of the document."""
        self.document.setdefault(kind, []).append(entries)
        return len(self.document[kind]) - 1

    def texture(self, pixels, kind: str = "PNG", **sampler) -> dict[str, int]:
        """The texture info of an 8-bit image, (H, W, C) bytes."""
        file = io.BytesIO()
        Image.fromarray(np.asarray(pixels, dtype=np.uint8)).save(file, kind)
        source = self.add("images", bufferView=self.view(file.getvalue()), mimeType=f"image/{kind.lower()}")
        more = {"sampler": self.add("samplers", **sampler)} if sampler else {}
        return {"index": self.add("textures", source=source, **more)}

    def square(self, material: int | None = None, uv=SQUARE_UV, **attributes) -> dict[str, Any]:
        """A primitive."""
        accessors = {"POSITION": self.array(SQUARE), "NORMAL": self.array([[0, 0, 1]] * 4), "TEXCOORD_0": self.array(uv)}
        return {"attributes": accessors | attributes, "indices": self.array(SQUARE_FACES, "uint16"),
                **({} if material is None else {"material": material})}

    def node(self, *primitives, root: bool = True, **entries) -> int:
        """A node, with a mesh if primitives are given."""
        if primitives:
            entries["mesh"] = self.add("meshes", primitives=list(primitives))
        number = self.add("nodes", **entries)
        if root:
            self.document["scenes"][0]["nodes"].append(number)
        return number

    def save(self, path: Path) -> Path:
        """Writes a .glb, or a .gltf with a data URI."""
        document = json.loads(json.dumps(self.document))
        document["buffers"][0].setdefault("byteLength", len(self.binary))
        if path.suffix == ".gltf":
            document["buffers"][0].setdefault("uri", "data:application/octet-stream;base64,"
                                              + base64.b64encode(self.binary).decode())
            path.write_text(json.dumps(document))
            return path
        text = json.dumps(document).encode()
        text += b" " * (-len(text) % 4)
        chunks = struct.pack("<I4s", len(text), b"JSON") + text
        binary = self.binary + b"\0" * (-len(self.binary) % 4)
        chunks += struct.pack("<I4s", len(binary), b"BIN\0") + binary
        path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)
        return path


def set_to(*path, to):
    """A function that replaces an entry of the document, such as accessors, 0, count."""
    def spoil(file):
        inner = file.document
        for key in path[:-1]:
            inner = inner[key]
        inner[path[-1]] = to

    return spoil
