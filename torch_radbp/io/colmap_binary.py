"""Reads COLMAP's binary format into the words of its text format.

Reference: COLMAP's documentation, "Output Format", and its source, `src/colmap/sensor/models.h`, for the numbers of models.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from torch_radbp.formats.files import opened
from torch_radbp.plugin import SceneError

# Models and how many parameters they have, in the order of their numbers.
MODELS = (("SIMPLE_PINHOLE", 3), ("PINHOLE", 4), ("SIMPLE_RADIAL", 4), ("RADIAL", 5), ("OPENCV", 8), ("OPENCV_FISHEYE", 8),
          ("FULL_OPENCV", 12), ("FOV", 5), ("SIMPLE_RADIAL_FISHEYE", 4), ("RADIAL_FISHEYE", 5), ("THIN_PRISM_FISHEYE", 12),
          ("RAD_TAN_THIN_PRISM_FISHEYE", 16), ("SIMPLE_DIVISION", 4), ("DIVISION", 5), ("SIMPLE_FISHEYE", 3), ("FISHEYE", 4),
          ("EUCM", 6), ("EQUIRECTANGULAR", 2))
POINT_BYTES = 24  # of an observation: x, y and the number of a point
LONGEST_NAME = 4096  # bytes


class Records:
    """A little-endian binary file that is read piece by piece.

    Args:
        path: of the file, for messages.
        file: open to read bytes.
    """

    def __init__(self, path: Path, file: BinaryIO):
        self.path, self.file, self.number = path, file, 0
        self.size = os.path.getsize(path)
        self.count, = self.take("Q")

    def __iter__(self) -> Iterator[int]:
        """Yields the numbers of the records, from 1, each while it is being read."""
        while self.number < self.count:
            self.number += 1
            yield self.number

    def fail(self, message: str) -> SceneError:
        """The error about this record, to be raised."""
        return SceneError(f"{self.path}, record {self.number}: {message}")

    def take(self, layout: str) -> tuple:
        """Reads the next numbers, in the layout of `struct` without gaps."""
        length = struct.calcsize(f"<{layout}")
        data = self.file.read(length)
        if len(data) < length:
            raise self.fail(f"the file ends after {self.size} bytes; is it cut short?")
        return struct.unpack(f"<{layout}", data)

    def text(self) -> str:
        """Reads characters up to a zero."""
        content = bytearray()
        while (byte := self.take("c")[0]) != b"\0":
            content += byte
            if len(content) > LONGEST_NAME:
                raise self.fail(f"the name of an image has more than {LONGEST_NAME} bytes; is the file damaged?")
        try:
            return content.decode()
        except UnicodeDecodeError:
            raise self.fail("the name of an image is no text; is the file damaged?") from None

    def skip(self, length: int) -> None:
        """Skips bytes, which must exist."""
        if self.file.tell() + length > self.size:
            raise self.fail(f"the file ends after {self.size} bytes; is it cut short?")
        self.file.seek(length, os.SEEK_CUR)


def binary_cameras(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Yields the number of each record of cameras.bin and its words CAMERA_ID MODEL WIDTH HEIGHT PARAMETERS."""
    with opened(path) as file:
        records = Records(path, file)
        for number in records:
            camera, model, width, height = records.take("IiQQ")
            if not 0 <= model < len(MODELS):
                raise records.fail(f"the camera model {model} is not known; known: 0 to {len(MODELS) - 1}")
            name, count = MODELS[model]
            yield number, [str(camera), name, str(width), str(height), *map(repr, records.take(f"{count}d"))]


def binary_images(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Yields each record's number and words IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME of images.bin."""
    with opened(path) as file:
        records = Records(path, file)
        for number in records:
            image, *pose, camera = records.take("I7dI")
            name = records.text()
            records.skip(POINT_BYTES * records.take("Q")[0])
            yield number, [str(image), *map(repr, pose), str(camera), name]
