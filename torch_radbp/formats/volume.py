"""Reads and writes grids of numbers in Mitsuba's volume format, version 3; strictly.

After "VOL" and the version, a byte, follow as int32: the kind of numbers (1: float32, the only one that Mitsuba reads),
the sizes along x, y and z, and the number of channels; then as float32 the two corners of a box, which an `sdfgrid` does not
use, and the values, all channels of a point together, x fastest. Little-endian.

Reference: the format's description in the documentation of Mitsuba 3, "Grid-based volume data source".
"""

from __future__ import annotations

import os
import struct

import numpy as np

from torch_radbp.formats.files import opened

MAGIC, VERSION, FLOAT32 = b"VOL", 3, 1
HEADER = struct.Struct("<3sB5i6f")
UNIT_BOX = (0.0, 0.0, 0.0, 1.0, 1.0, 1.0)


def read_volume(path: str | os.PathLike) -> np.ndarray:
    """The values of a volume of one channel, (Z, Y, X, 1) float32.

    Raises:
        FileNotFoundError: if there is no such file.
        IsADirectoryError: if it is a folder.
        ValueError: names the file, of what is malformed, cut short, of several channels or not finite.
    """
    place = os.fspath(path)
    with opened(path) as file:
        data = file.read()
    if len(data) < HEADER.size:
        raise ValueError(f"{place}: cut short, a volume begins with {HEADER.size} bytes, got {len(data)}")
    magic, version, kind, *sizes, channels, _, _, _, _, _, _ = HEADER.unpack_from(data)
    if magic != MAGIC:
        raise ValueError(f"{place}: a volume begins with {MAGIC!r}, got {magic!r}")
    if version != VERSION:
        raise ValueError(f"{place}: the version must be {VERSION}, got {version}")
    if kind != FLOAT32:
        raise ValueError(f"{place}: its numbers must be float32 (kind {FLOAT32}), got kind {kind}")
    if min(sizes) < 1:
        raise ValueError(f"{place}: its sizes along x, y and z must be at least 1, got {', '.join(map(str, sizes))}")
    if channels != 1:
        raise ValueError(f"{place}: it must have one channel, got {channels}")
    x, y, z = sizes
    if len(data) != HEADER.size + 4 * x * y * z:
        raise ValueError(f"{place}: {x} x {y} x {z} values need {4 * x * y * z} bytes after the header, got "
                         f"{len(data) - HEADER.size}; is the file cut short?")
    values = np.frombuffer(data, "<f4", offset=HEADER.size).reshape(z, y, x, 1)
    bad = ~np.isfinite(values)
    if bad.any():
        first = np.argwhere(bad[..., 0])[0][::-1].tolist()
        raise ValueError(f"{place}: {int(bad.sum())} of its values are NaN or infinite, the first of them at x, y, z = "
                         f"{', '.join(map(str, first))}")
    return values.astype(np.float32)


def write_volume(path: str | os.PathLike, values: np.ndarray) -> None:
    """Writes values, (Z, Y, X, 1), as float32 in the unit cube."""
    depth, height, width, channels = values.shape
    with open(path, "wb") as file:
        file.write(HEADER.pack(MAGIC, VERSION, FLOAT32, width, height, depth, channels, *UNIT_BOX))
        file.write(np.ascontiguousarray(values, "<f4").tobytes())
