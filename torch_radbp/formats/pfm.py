"""Reads portable float maps (.pfm): a header of three lines, and plain numbers, the lowest row first.

No library that the package needs anyway reads those with colours.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable

import numpy as np

from torch_radbp.formats.files import opened

HEADER = re.compile(rb"(P[Ff])\s+(\d{1,9})\s+(\d{1,9})\s+([+-]?[\d.eE+-]+)\s")
LONGEST_HEADER = 1 << 10


def read_pfm(path: str | os.PathLike, check_size: Callable[[int, int], None]) -> np.ndarray:
    """Reads a portable float map: (H, W, 3) or (H, W, 1) float32, row 0 at the top.

    Args:
        path: the file.
        check_size: called with width and height before anything of that size is made.

    Raises:
        ValueError: if the header is malformed or the file is shorter or longer than it says.
    """
    with opened(path) as file:
        header = HEADER.match(file.read(LONGEST_HEADER))
        if header is None:
            raise ValueError("its header must read PF or Pf, width, height and scale")
        channels, width, height, scale = 3 if header[1] == b"PF" else 1, int(header[2]), int(header[3]), float(header[4])
        check_size(width, height)
        file.seek(header.end())
        data = file.read()
    wanted = 4 * width * height * channels
    if len(data) != wanted:
        raise ValueError(f"its pixels take {wanted} bytes, it has {len(data)}")
    pixels = np.frombuffer(data, "<f4" if scale < 0 else ">f4").reshape(height, width, channels)
    return pixels[::-1].astype(np.float32)
