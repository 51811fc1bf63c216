"""A glTF document under construction, with its one buffer."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
from PIL import Image

FLOAT, SHORT, INTEGER = 5126, 5123, 5125
VERTICES, INDICES = 34962, 34963  # targets of buffer views
TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}
MOST_SHORT = 65535  # vertices that two bytes can number: the last number is reserved


class Written:
    """A glTF document under construction: lists of objects that grow; equal objects are written once."""

    def __init__(self) -> None:
        self.lists: dict[str, list[dict[str, Any]]] = {}
        self.cached: dict[tuple[Any, ...], int] = {}
        self.extensions: set[str] = set()
        self.lights: list[dict[str, Any]] = []
        self.binary = bytearray()

    def add(self, kind: str, entries: dict[str, Any]) -> int:
        """Appends an object to a list and returns its index."""
        self.lists.setdefault(kind, []).append(entries)
        return len(self.lists[kind]) - 1

    def once(self, kind: str, entries: dict[str, Any]) -> int:
        """Returns the index of an object with these entries, which is appended if there is none."""
        key = kind, repr(entries)
        if key not in self.cached:
            self.cached[key] = self.add(kind, entries)
        return self.cached[key]

    def extension(self, name: str, entries: dict[str, Any]) -> dict[str, Any]:
        """An entry for `extensions`, whose name is noted among those used."""
        self.extensions.add(name)
        return {name: entries}

    def view(self, content: bytes, **more: int) -> int:
        """Appends bytes to the buffer, aligned to 4, and returns the index of their view."""
        self.binary += b"\0" * (-len(self.binary) % 4)
        start = len(self.binary)
        self.binary += content
        return self.add("bufferViews", {"buffer": 0, "byteOffset": start, "byteLength": len(content), **more})

    def vertices(self, values: np.ndarray, bounds: bool = False) -> int:
        """Writes (V, K) numbers and returns the index of their accessor; `bounds`: with extremes, as positions must have."""
        values = np.ascontiguousarray(values, dtype="<f4")
        more = {"min": values.min(0).astype(float).tolist(), "max": values.max(0).astype(float).tolist()} if bounds else {}
        return self.add("accessors", {"bufferView": self.view(values.tobytes(), target=VERTICES), "componentType": FLOAT,
                                      "count": len(values), "type": TYPES[values.shape[1]], **more})

    def indices(self, faces: np.ndarray, vertices: int) -> int:
        """Writes the corners of triangles and returns the index of their accessor."""
        kind, dtype = (SHORT, "<u2") if vertices <= MOST_SHORT else (INTEGER, "<u4")
        corners = np.ascontiguousarray(faces.reshape(-1), dtype=dtype)
        return self.add("accessors", {"bufferView": self.view(corners.tobytes(), target=INDICES), "componentType": kind,
                                      "count": len(corners), "type": "SCALAR"})

    def image(self, pixels: np.ndarray, name: str) -> int:
        """Writes (H, W, 3 or 4) bytes as a PNG in the buffer and returns its index."""
        file = io.BytesIO()
        Image.fromarray(pixels).save(file, "PNG", optimize=True)
        key = "image", file.getvalue()
        if key not in self.cached:
            view = self.view(file.getvalue())
            self.cached[key] = self.add("images", {"name": name, "mimeType": "image/png", "bufferView": view})
        return self.cached[key]

    def light(self, entries: dict[str, Any]) -> dict[str, Any]:
        """Adds a light and returns the entry for `extensions` of its node."""
        self.lights.append(entries)
        return self.extension("KHR_lights_punctual", {"light": len(self.lights) - 1})

    def document(self, uri: str | None) -> dict[str, Any]:
        """The finished document; `uri` names the file of the buffer, None if it is part of the same file."""
        document: dict[str, Any] = {"asset": {"version": "2.0", "generator": "torch_radbp"}, "scene": 0}
        document["scenes"] = [{"nodes": list(range(len(self.lists.get("nodes", []))))}]
        document |= self.lists
        if self.binary:
            document["buffers"] = [{"byteLength": len(self.binary), **({} if uri is None else {"uri": uri})}]
        if self.lights:
            document["extensions"] = {"KHR_lights_punctual": {"lights": self.lights}}
        if self.extensions:
            document["extensionsUsed"] = sorted(self.extensions)
        return document
