"""Reads the tables of an ascii PLY file."""

from __future__ import annotations

from collections.abc import Iterator
from typing import BinaryIO

import numpy as np

from torch_radbp.formats.ply_header import PLYElement
from torch_radbp.formats.text_lines import Lines, read_lines


class AsciiTables:
    """The tables of an ascii PLY file, one line for each row, read in order."""

    def __init__(self, file: BinaryIO, first_line: int, place: str):
        self.place = place
        self.blocks = read_lines(file, place, first_line)
        self.rest: Lines | None = None  # lines of the last block that are not taken
        self.numbers: dict[str, np.ndarray] = {}  # element -> (rows,) its lines

    def where(self, element: str, row: int) -> str:
        """The line of the file in which a row of an element stands, for messages."""
        return f"{self.place}, line {self.numbers[element][row]}"

    def finish(self) -> None:
        """Raises ValueError if the file has lines after the last table."""
        for lines in (self.rest, *self.blocks):
            if lines is not None and lines.rows > 0:
                raise ValueError(f"{self.place}, line {lines.numbers[0]}: follows after the last element of the header")

    def take(self, element: PLYElement) -> Iterator[Lines]:
        """Yields the lines of an element's rows, block by block."""
        missing, numbers = element.rows, [np.empty(0, np.int64)]
        while missing > 0:
            lines = self.rest if self.rest is not None and self.rest.rows > 0 else next(self.blocks, None)
            if lines is None:
                raise ValueError(f"{self.place}: cut short, it has {element.rows - missing} of the {element.rows} rows of "
                                 f"element {element.name!r}")
            self.rest = lines.between(missing, lines.rows)
            part = lines.between(0, missing)
            missing -= part.rows
            numbers.append(part.numbers)
            yield part
        self.numbers[element.name] = np.concatenate(numbers)

    def columns(self, element: PLYElement) -> dict[str, np.ndarray]:
        """Reads the properties of an element without lists."""
        width = len(element.properties)
        blocks = [np.empty((0, width))]
        for lines in self.take(element):
            self.check_width(element, lines, np.diff(lines.first), np.full(lines.rows, width))
            values = lines.values(np.arange(lines.first[0], lines.first[-1]), self.place, finite=False)
            blocks.append(values.reshape(-1, width))
        table = np.concatenate(blocks)
        return {p.name: table[:, column] for column, p in enumerate(element.properties)}

    def lists(self, element: PLYElement, wanted: str | None) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
        """Reads an element with lists: entries of the list `wanted`, (rows,) their counts, and the other properties."""
        entries, counts = [np.empty(0)], [np.empty(0, np.int64)]
        others = {p.name: [np.empty(0)] for p in element.properties if p.count is None and wanted is not None}
        for lines in self.take(element):
            values = lines.values(np.arange(lines.first[0], lines.first[-1]), self.place, finite=False)
            begin, words = lines.first[:-1] - lines.first[0], np.diff(lines.first)
            read = np.zeros_like(words)  # of each row, how many of its words are accounted for
            for name, _, count in element.properties:
                if count is None:
                    self.check_width(element, lines, words, np.maximum(words, read + 1))
                    if name in others:
                        others[name].append(values[begin + read])
                    read += 1
                    continue
                self.check_width(element, lines, words, np.maximum(words, read + 1))
                length = values[begin + read]
                bad = (length < 0) | (length % 1 != 0) | (length > words)
                if bad.any():
                    row = int(np.argmax(bad))
                    raise ValueError(f"{self.place}, line {lines.numbers[row]}: a list of {length[row]:g} entries, but the "
                                     f"line has {words[row]} numbers")
                length = length.astype(np.int64)
                if name == wanted:
                    first = begin + read + 1
                    self.check_width(element, lines, words, np.maximum(words, read + 1 + length))
                    step = np.arange(length.sum()) - np.repeat(np.cumsum(length) - length, length)
                    entries.append(values[np.repeat(first, length) + step])
                    counts.append(length)
                read += 1 + length
            self.check_width(element, lines, words, read)
        return (np.concatenate(entries), np.concatenate(counts),
                {name: np.concatenate(parts) for name, parts in others.items()})

    def check_width(self, element: PLYElement, lines: Lines, words: np.ndarray, wanted: np.ndarray) -> None:
        """Raises ValueError with the line of the first row that has not `wanted` many numbers."""
        if (words != wanted).any():
            row = int(np.argmax(words != wanted))
            raise ValueError(f"{self.place}, line {lines.numbers[row]}: a row of element {element.name!r} has {wanted[row]} "
                             f"numbers here, got {words[row]}")
