"""Reads Radiance pictures (.hdr): three mantissas with one exponent for each pixel.

No library that the package needs anyway reads them.

Reference: Ward 1991, "Real Pixels", in Graphics Gems II.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable

import numpy as np

from torch_radbp.formats.files import opened

LINE_END = re.compile(rb"\r?\n")
AXES = re.compile(rb"\s*[-+][XY]\s")
SIZE = re.compile(rb"\s*-Y\s+(\d{1,9})\s+\+X\s+(\d{1,9})\s*")
FORMAT = b"32-bit_rle_rgbe"
LONGEST_HEADER = 1 << 16
MARK = b"\x02\x02"  # begins a row whose runs are encoded, channel by channel
WIDTHS = range(8, 1 << 15)  # of rows that can be encoded


def read_radiance(path: str | os.PathLike, check_size: Callable[[int, int], None]) -> np.ndarray:
    """Reads a Radiance picture: (H, W, 3) float32, row 0 at the top.

    Args:
        path: the file.
        check_size: called with width and height before anything of that size is made.

    Raises:
        ValueError: on another format than RGBE from top left to bottom right, and on files cut short or damaged.
    """
    with opened(path) as file:
        width, height, place = _size(file.read(LONGEST_HEADER))
        check_size(width, height)
        file.seek(0)
        data = file.read()
    parts: list[np.ndarray] = []  # (R, 4, W) rows
    for row in range(height):
        if data[place:place + 2] == MARK and width in WIDTHS and data[place + 2] < 128:
            parts.append(np.empty((1, 4, width), dtype=np.uint8))
            place = _decode_row(data, place, parts[-1][0])
            continue
        rest = 4 * width * (height - row)
        if len(data) - place < rest:
            raise ValueError(f"its pixels are cut short in row {row} of {height}")
        parts.append(np.frombuffer(data, np.uint8, rest, place).reshape(-1, width, 4).transpose(0, 2, 1))
        break
    pixels = np.concatenate(parts)
    mantissa, exponent = pixels[:, :3].astype(np.float32), pixels[:, 3:].astype(np.int32)
    values = np.where(exponent == 0, np.float32(0), np.ldexp(mantissa, exponent - (128 + 8)))
    return np.ascontiguousarray(values.transpose(0, 2, 1), dtype=np.float32)


def _size(header: bytes) -> tuple[int, int, int]:
    """Width and height from the header of a Radiance picture, and the byte at which its pixels begin.

    The line with the size ends the header; which line ends, blanks, empty lines and variables come before does not matter.
    """
    formats, place = [], 0
    for end in LINE_END.finditer(header):
        line, place = header[place:end.start()], end.end()
        if line.startswith(b"FORMAT="):
            formats.append(line.removeprefix(b"FORMAT=").strip())
        if AXES.match(line):
            break
    else:
        line = b""
    if formats != [FORMAT]:
        raise ValueError(f"its format must be {FORMAT.decode()}, got {', '.join(map(repr, formats)) or 'none'}")
    size = SIZE.fullmatch(line)
    if size is None:
        raise ValueError(f"its size must read -Y height +X width, got {line[:40]!r}")
    return int(size[2]), int(size[1]), place


def _decode_row(data: bytes, place: int, row: np.ndarray) -> int:
    """Decodes the runs of one row into (4, W) channels, from byte `place` on; returns where the next row begins."""
    width = row.shape[1]
    if int.from_bytes(data[place + 2:place + 4], "big") != width:
        raise ValueError("its content is damaged")
    place += 4
    for channel in row:
        column = 0
        while column < width:
            if place + 1 >= len(data):
                raise ValueError("its pixels are cut short")
            count = data[place]
            repeated = count > 128
            count -= 128 * repeated
            if count == 0 or column + count > width or (not repeated and place + 1 + count > len(data)):
                raise ValueError("its content is damaged")
            if repeated:
                channel[column:column + count] = data[place + 1]
                place += 2
            else:
                channel[column:column + count] = np.frombuffer(data, np.uint8, count, place + 1)
                place += 1 + count
            column += count
    return place
