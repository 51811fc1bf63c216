"""Reads the tables of a binary PLY file."""

from __future__ import annotations

import struct

import numpy as np

from torch_radbp.formats.ply_header import PLYElement

STRUCT_CODES = {"i1": "b", "u1": "B", "i2": "h", "u2": "H", "i4": "i", "u4": "I", "f4": "f", "f8": "d"}


class BinaryTables:
    """The tables of a binary PLY file, read in order."""

    def __init__(self, data: bytes, order: str, place: str):
        self.data, self.order, self.place = data, order, place
        self.offset = 0

    def where(self, element: str, row: int) -> str:
        """The file, element and number of a row, for error messages."""
        return f"{self.place}, {element} {row} (from 0)"

    def finish(self) -> None:
        """Raises ValueError if the file has bytes after the last table."""
        left = len(self.data) - self.offset
        if left:
            raise ValueError(f"{self.place}: {left} bytes follow after the last element of the header")

    def columns(self, element: PLYElement) -> dict[str, np.ndarray]:
        """Reads the properties of an element without lists."""
        table = self.table(element, self.dtype(element, {}))
        return {p.name: table[p.name] for p in element.properties}

    def lists(self, element: PLYElement, wanted: str | None) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
        """Reads an element with lists: entries of the list `wanted`, (rows,) their counts, and the other properties."""
        begin, none = self.offset, np.empty(0, np.int64)
        scalars = [p.name for p in element.properties if p.count is None]
        if element.rows == 0 or not element.properties:
            return none, none, {}
        lengths = self.lengths_of_first_row(element)
        dtype = self.dtype(element, lengths)
        if begin + element.rows * dtype.itemsize <= len(self.data):  # of equal rows, as a rule
            table = self.table(element, dtype)
            if all((table[f"{name} count"] == length).all() for name, length in lengths.items()):
                if wanted is None:
                    return none, none, {}
                others = {name: table[name] for name in scalars}
                return table[wanted].reshape(-1), np.full(element.rows, lengths[wanted]), others
        self.offset = begin
        starts, counts, places = self.walk(element, wanted)
        kind = next((np.dtype(self.order + p.kind) for p in element.properties if p.name == wanted), None)
        if kind is None:
            return none, none, {}
        entry = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
        kinds = {p.name: np.dtype(self.order + p.kind) for p in element.properties if p.count is None}
        return (self.scattered(np.repeat(starts, counts) + entry * kind.itemsize, kind), counts,
                {name: self.scattered(places[:, column], kinds[name]) for column, name in enumerate(scalars)})

    def scattered(self, places: np.ndarray, kind: np.dtype) -> np.ndarray:
        """The numbers that begin at given byte offsets."""
        return np.frombuffer(self.data, np.uint8)[places[:, None] + np.arange(kind.itemsize)].view(kind).reshape(-1)

    def dtype(self, element: PLYElement, lengths: dict[str, int]) -> np.dtype:
        """The dtype of a row whose lists have these lengths."""
        fields = []
        for name, kind, count in element.properties:
            if count is None:
                fields.append((name, self.order + kind))
            else:
                fields += [(f"{name} count", self.order + count), (name, self.order + kind, (lengths[name],))]
        return np.dtype(fields)

    def table(self, element: PLYElement, dtype: np.dtype) -> np.ndarray:
        """Reads all rows of an element, (rows,) of a structured dtype."""
        needed, left = element.rows * dtype.itemsize, len(self.data) - self.offset
        if needed > left:
            raise self.cut_short(element, left // max(1, dtype.itemsize))
        table = np.frombuffer(self.data, dtype, element.rows, self.offset)
        self.offset += needed
        return table

    def lengths_of_first_row(self, element: PLYElement) -> dict[str, int]:
        """The lengths of the lists in the next row."""
        offset, lengths = self.offset, {}
        for name, kind, count in element.properties:
            if count is not None:
                lengths[name] = self.length(element, 0, offset, struct.Struct(self.order + STRUCT_CODES[count]))
                offset += int(count[1]) + lengths[name] * int(kind[1])
            else:
                offset += int(kind[1])
        if offset > len(self.data):
            raise self.cut_short(element, 0)
        return lengths

    def walk(self, element: PLYElement, wanted: str | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The byte offset and length of the list `wanted` in each row, and the offsets of the other properties.

        For rows of different sizes, one after the other.
        """
        if element.rows > len(self.data) - self.offset:
            raise self.cut_short(element, 0)
        steps = [(name == wanted, int(kind[1]), count and struct.Struct(self.order + STRUCT_CODES[count]))
                 for name, kind, count in element.properties]
        starts, counts = np.empty(element.rows, np.int64), np.zeros(element.rows, np.int64)
        places = np.zeros((element.rows, sum(count is None for _, _, count in steps)), np.int64)
        offset = self.offset
        for row in range(element.rows):
            column = 0
            for is_wanted, size, count in steps:
                if count is None:
                    places[row, column] = offset
                    column += 1
                    offset += size
                    continue
                length = self.length(element, row, offset, count)
                offset += count.size
                if is_wanted:
                    starts[row], counts[row] = offset, length
                offset += length * size
        if offset > len(self.data):
            raise self.cut_short(element, element.rows - 1)
        self.offset = offset
        return starts, counts, places

    def length(self, element: PLYElement, row: int, offset: int, count: struct.Struct) -> int:
        """Reads the length of the list that begins at a byte offset in a row."""
        if offset + count.size > len(self.data):
            raise self.cut_short(element, row)
        length = count.unpack_from(self.data, offset)[0]
        if not length >= 0 or length % 1 != 0:
            raise ValueError(f"{self.where(element.name, row)}: a list cannot have {length} entries")
        return int(length)

    def cut_short(self, element: PLYElement, row: int) -> ValueError:
        """The error about a file that ends within an element."""
        return ValueError(f"{self.place}: cut short, it ends in row {row} of the {element.rows} rows of element "
                          f"{element.name!r}")
