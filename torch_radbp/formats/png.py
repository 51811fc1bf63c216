"""Checks that a PNG file contains all pixels that its header promises.

Reference: W3C 2003, "Portable Network Graphics (PNG) Specification", sections 8 and 11.
"""

from __future__ import annotations

import os
import struct
import zlib
from typing import BinaryIO

CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}  # of each colour type
WHOLE = ((0, 0, 1, 1),)  # first column and row, steps between them
INTERLACED = ((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2))
BLOCK = 1 << 20


def check_pixel_data(file: BinaryIO) -> None:
    """Raises ValueError or zlib.error if the compressed pixels of a PNG file are damaged or fewer than its header says.

    Lengths and check sums of its chunks must be right; what follows the last chunk is ignored.
    """
    stream, size, expected = zlib.decompressobj(), 0, 0
    file.seek(8)
    while len(begin := file.read(8)) == 8:
        length, kind = struct.unpack(">I4s", begin)
        if kind == b"IEND":
            break
        data = file.read(length)
        file.seek(4, os.SEEK_CUR)  # the check sum
        if kind == b"IHDR":
            expected = _size(*struct.unpack(">IIBBBBB", data))
        elif kind == b"IDAT":
            while data:
                size += len(stream.decompress(data, BLOCK))
                data = stream.unconsumed_tail
    size += len(stream.flush())
    if size < expected or not stream.eof:
        raise ValueError(f"its pixels take {expected} bytes, it has {size}")


def _size(width: int, height: int, bits: int, colour: int, compression: int, filtering: int, interlace: int) -> int:
    """The number of bytes of all decompressed rows, each with the byte of its filter."""
    if colour not in CHANNELS:
        raise ValueError(f"colour type {colour} does not exist")
    total = 0
    for column, row, step_x, step_y in INTERLACED if interlace else WHOLE:
        columns, rows = (max(0, width - column + step_x - 1) // step_x, max(0, height - row + step_y - 1) // step_y)
        total += rows * (1 + (columns * bits * CHANNELS[colour] + 7) // 8) if columns else 0
    return total
