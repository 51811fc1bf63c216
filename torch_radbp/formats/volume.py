"""Reads and writes grids of numbers in Mitsuba's volume format, version 3; strictly.

After "VOL" and the version, a byte, follow as int32: the kind of numbers (1: float32, the only one that Mitsuba reads),
the sizes along x, y and z, and the number of channels; then as float32 the two corners of a box and the values, all channels
of a point together, x fastest. Little-endian.

Reference: the format's description in the documentation of Mitsuba 3, "Grid-based volume data source".
"""

from __future__ import annotations

import os
import struct
from typing import NamedTuple

import numpy as np

from torch_radbp.formats.files import opened

MAGIC, VERSION, FLOAT32 = b"VOL", 3, 1
HEADER = struct.Struct("<3sB5i6f")
UNIT_BOX = (0.0, 0.0, 0.0, 1.0, 1.0, 1.0)


class VolumeFile(NamedTuple):
    """The values in a volume file, and the box that they fill."""

    values: np.ndarray  # (Z, Y, X, C) float32
    box: tuple[float, ...]  # the least x, y and z of its box, and the greatest


def read_volume(path: str | os.PathLike, possible: tuple[int, ...] = (1,)) -> VolumeFile:
    """Reads the values of a volume file, and the box that they fill.

    Args:
        path: of the file.
        possible: the numbers of channels that it may have.

    Raises:
        FileNotFoundError: if there is no such file.
        IsADirectoryError: if it is a folder.
        ValueError: names the file, if it is malformed, cut short, of another number of channels or not finite.
    """
    place = os.fspath(path)
    with opened(path) as file:
        data = file.read()
    if len(data) < HEADER.size:
        raise ValueError(f"{place}: cut short, a volume begins with {HEADER.size} bytes, got {len(data)}")
    magic, version, kind, x, y, z, channels, *box = HEADER.unpack_from(data)
    if magic != MAGIC:
        raise ValueError(f"{place}: a volume begins with {MAGIC!r}, got {magic!r}")
    if version != VERSION:
        raise ValueError(f"{place}: the version must be {VERSION}, got {version}")
    if kind != FLOAT32:
        raise ValueError(f"{place}: its numbers must be float32 (kind {FLOAT32}), got kind {kind}")
    if min(x, y, z) < 1:
        raise ValueError(f"{place}: its sizes along x, y and z must be at least 1, got {x}, {y}, {z}")
    if channels not in possible:
        numbers = "one channel" if possible == (1,) else f"{' or '.join(map(str, possible))} channels"
        raise ValueError(f"{place}: it must have {numbers}, got {channels}")
    needed = 4 * x * y * z * channels  # the file has been read: nothing of this size is allocated
    if len(data) != HEADER.size + needed:
        of_each = f" of {channels} channels" if channels > 1 else ""
        raise ValueError(f"{place}: {x} x {y} x {z} values{of_each} need {needed} bytes after the header, got "
                         f"{len(data) - HEADER.size}; is the file cut short?")
    values = np.frombuffer(data, "<f4", offset=HEADER.size).reshape(z, y, x, channels)
    bad = ~np.isfinite(values)
    if bad.any():
        first = np.argwhere(bad)[0][2::-1].tolist()
        raise ValueError(f"{place}: {int(bad.sum())} of its values are NaN or infinite, the first of them at x, y, z = "
                         f"{', '.join(map(str, first))}")
    return VolumeFile(values.astype(np.float32), tuple(box))


def write_volume(path: str | os.PathLike, values: np.ndarray, box: tuple[float, ...] = UNIT_BOX) -> None:
    """Writes values, (Z, Y, X, C), as float32 in a box, that of `VolumeFile`."""
    depth, height, width, channels = values.shape
    with open(path, "wb") as file:
        file.write(HEADER.pack(MAGIC, VERSION, FLOAT32, width, height, depth, channels, *box))
        file.write(np.ascontiguousarray(values, "<f4").tobytes())
