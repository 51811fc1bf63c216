"""Buffers of a glTF document, and the arrays ("accessors") in them."""

from __future__ import annotations

import base64
import binascii
import os
import re
from pathlib import Path
from urllib.parse import unquote, urlsplit

import numpy as np

from torch_radbp.formats.files import opened
from torch_radbp.io.gltf.document import Document, DocumentPart

COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
TYPES = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
MESHOPT = ("EXT_meshopt_compression", "KHR_meshopt_compression")
MAX_NUMBERS = 2**28  # of all accessors together, counted as often as nodes use them: a small file can ask for any number
MAX_ZEROS = 2**20  # of all accessors without a buffer view together, which take no place in the file
MAX_RESOURCE = 2**30  # bytes of an image's file


class Buffers:
    """The buffers of a glTF document.

    Args:
        document: the file's.
        binary: its binary chunk, if it has one.
        folder: that file names are relative to.
        allow_outside: also read files that do not lie in `folder`, or below.
    """

    def __init__(self, document: Document, binary: bytes | None, folder: Path, allow_outside: bool = False):
        self.document, self.binary, self.folder, self.allow_outside = document, binary, folder, allow_outside
        self.cached: dict[int, bytes] = {}
        self.numbers = self.zeros = 0  # claimed so far

    def buffer(self, index: int, user: DocumentPart) -> bytes:
        """Reads a buffer: from the GLB file, a data URI or a file beside it."""
        if index not in self.cached:
            part = self.document.of("buffers", index, user, "buffer")
            length, uri = part.integer("byteLength"), part.text("uri", None)
            if uri is not None:
                content = self.resource(uri, part, length)
            elif index == 0 and self.binary is not None:
                content = self.binary
            else:
                raise part.fail("it has no uri, and the file has no binary chunk that it could stand for")
            if len(content) < length:
                raise part.fail(f"byteLength is {length}, but there are {len(content)} bytes; is the file cut short?")
            self.cached[index] = content[:length]
        return self.cached[index]

    def resource(self, uri: str, user: DocumentPart, length: int = -1) -> bytes:
        """Reads the first `length` bytes behind a URI, a data URI or a relative file name; -1: all."""
        if uri[:5].lower() == "data:":
            head, comma, body = uri.partition(",")
            if not comma or not head.lower().endswith(";base64"):
                raise user.fail("a data URI must be encoded as base64: data:...;base64,...")
            body = "".join(unquote(body).split()).rstrip("=")  # line breaks and padding as one likes
            try:
                return base64.b64decode(body + "=" * (-len(body) % 4), validate=True)
            except (binascii.Error, ValueError) as error:
                raise user.fail(f"its data URI is damaged: {error}") from error
        path = self.path(uri, user)
        try:
            with opened(path) as file:
                held = os.fstat(file.fileno()).st_size
                if length < 0 and held > MAX_RESOURCE:
                    raise user.fail(f"{path}: an image's file may have at most {MAX_RESOURCE} bytes, this one has {held}")
                return file.read(held if length < 0 else min(length, held))
        except OSError as error:
            raise user.fail(str(error)) from error

    def path(self, uri: str, user: DocumentPart) -> Path:
        """The path of the file that a URI names, relative to the document; it need not exist.

        Raises:
            SceneError: if it is no file name, or leads out of the folder without leave.
        """
        try:
            scheme = urlsplit(uri).scheme
        except ValueError:
            scheme = ""
        if scheme or "\0" in uri:
            raise user.fail(f"the uri {uri[:80]!r} is no file name relative to the document; no other is read")
        path = self.folder / unquote(uri)
        if not path.is_file():  # a question mark, a number sign or a backslash can be a part of a file's name
            path = self.folder / unquote(re.split("[?#]", uri)[0]).replace("\\", "/")
        if not self.allow_outside and not path.resolve().is_relative_to(self.folder.resolve()):
            raise user.fail(f"the uri {uri[:80]!r} leads out of the folder of the document, {self.folder.resolve()}; if you "
                            "trust it, load it with allow_outside=True (on the command line --allow-outside)")
        return path

    def view(self, index: int, user: DocumentPart) -> tuple[memoryview, int | None]:
        """The bytes of a buffer view, and its stride if it has one."""
        part = self.document.of("bufferViews", index, user, "bufferView")
        packed = any(part.extension(name) is not None for name in MESHOPT)
        if packed and self.document.of("buffers", part.integer("buffer"), part, "buffer").text("uri", "") == "" and (
                part.integer("buffer") > 0 or self.binary is None):
            raise part.fail(f"{MESHOPT[0]} is not supported, and there is no buffer with the same uncompressed; unpack the "
                            "file, as with `gltfpack -noq`")
        content = self.buffer(part.integer("buffer"), part)
        start, length = part.integer("byteOffset", 0), part.integer("byteLength")
        if start + length > len(content):
            raise part.fail(f"it ends at byte {start + length} of a buffer of {len(content)} bytes")
        return memoryview(content)[start:start + length], part.integer("byteStride", None, low=1, high=252)

    def array(self, index: int, user: DocumentPart, entry: str, types: tuple[str, ...]) -> np.ndarray:
        """Reads the array of an accessor.

        Args:
            index: its number.
            user: the object that refers to it, by its entry `entry`.
            types: those that can stand there, such as VEC3.

        Returns:
            (N, K), float64 of what are or represent fractions, else int64.
        """
        part = self.document.of("accessors", index, user, entry)
        kind, dtype = part.text("type"), np.dtype(part.choice("componentType", COMPONENTS))
        if kind not in types:
            raise part.fail(f"type {kind!r} cannot be the {entry} of {user.place}, which takes {' or '.join(types)}")
        count, width = part.integer("count"), TYPES[kind]
        self.claim(part, count * width)
        if count == 0:
            elements = np.zeros((0, width), dtype)
        elif part.has("bufferView"):
            elements = self.elements(part, part.integer("bufferView"), count, width, dtype)
        else:
            elements = self.blank(part, count, width, dtype)
        if part.has("sparse"):
            elements = self.substituted(elements.copy(), part.part("sparse"))
        if dtype.kind == "f":
            return elements.astype(np.float64)
        if not part.flag("normalized"):
            return elements.astype(np.int64)
        return np.maximum(elements / np.float64(np.iinfo(dtype).max), -1.0)

    def claim(self, part: DocumentPart, numbers: int) -> None:
        """Counts numbers that are read for a part of the document, and limits their sum.

        Raises:
            SceneError: if these are too many.
        """
        self.numbers += numbers
        if self.numbers > MAX_NUMBERS:
            raise part.fail(f"with its {numbers} numbers the scene has more than {MAX_NUMBERS} numbers, counted as often as "
                            "nodes use them")

    def blank(self, part: DocumentPart, count: int, width: int, dtype: np.dtype) -> np.ndarray:
        """(count, width) zeros, for an accessor without a buffer view."""
        self.zeros += count * width
        if self.zeros > MAX_ZEROS:
            raise part.fail(f"it has no bufferView, so that its {count} elements are zeros that the file does not hold; of "
                            f"such numbers a scene may have {MAX_ZEROS}")
        return np.zeros((count, width), dtype)

    def elements(self, part: DocumentPart, view: int, count: int, width: int, dtype: np.dtype) -> np.ndarray:
        """Reads (count, width) elements of a buffer view."""
        content, stride = self.view(view, part)
        start, size = part.integer("byteOffset", 0), width * dtype.itemsize
        stride = size if stride is None else stride
        if stride < size:
            raise part.fail(f"its elements of {size} bytes overlap: the byteStride of bufferViews[{view}] is {stride}")
        end = start + stride * (count - 1) + size
        if end > len(content):
            raise part.fail(f"its {count} elements end at byte {end} of bufferViews[{view}], which has {len(content)}")
        return np.ndarray((count, width), dtype, content, start, (stride, dtype.itemsize))

    def substituted(self, elements: np.ndarray, sparse: DocumentPart) -> np.ndarray:
        """`elements` with those replaced that a sparse accessor lists."""
        count = sparse.integer("count", low=1, high=len(elements))
        where, what = sparse.part("indices"), sparse.part("values")
        dtype = np.dtype(where.choice("componentType", {key: COMPONENTS[key] for key in (5121, 5123, 5125)}))
        rows = self.elements(where, where.integer("bufferView"), count, 1, dtype)[:, 0].astype(np.int64)
        if (np.diff(rows) <= 0).any() or rows[-1] >= len(elements):
            raise where.fail(f"indices must increase and be less than {len(elements)}")
        elements[rows] = self.elements(what, what.integer("bufferView"), count, elements.shape[1], elements.dtype)
        return elements
