"""Reads the cameras of a COLMAP model: cameras and images, .txt or .bin.

Reference: COLMAP's documentation, "Output Format" and "Camera Models", and its source, `src/colmap/sensor/models.h`.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from typing_extensions import Unpack

from torch_radbp.formats.files import opened
from torch_radbp.formats.picture_size import MAX_PIXELS
from torch_radbp.formats.text_lines import BYTE_ORDER_MARK
from torch_radbp.io.colmap_binary import binary_cameras, binary_images
from torch_radbp.io.opencv import LARGEST, SMALLEST, Intrinsics, SensorAttributes, pose_of, sensor_of
from torch_radbp.plugin import SceneError, nearest
from torch_radbp.public_call import passing_on, public_call
from torch_radbp.sensor.calibrated import (
    BROWN_CONRADY,
    FIELD_OF_VIEW,
    FISHEYE,
    THIN_PRISM_FISHEYE,
    Calibrated,
)

MODELS = {  # the parameters in their order; f is both focal lengths
    "SIMPLE_PINHOLE": (BROWN_CONRADY, ("f", "cx", "cy")),
    "PINHOLE": (BROWN_CONRADY, ("fx", "fy", "cx", "cy")),
    "SIMPLE_RADIAL": (BROWN_CONRADY, ("f", "cx", "cy", "k1")),
    "RADIAL": (BROWN_CONRADY, ("f", "cx", "cy", "k1", "k2")),
    "OPENCV": (BROWN_CONRADY, ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2")),
    "FULL_OPENCV": (BROWN_CONRADY, ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")),
    "OPENCV_FISHEYE": (FISHEYE, ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4")),
    "SIMPLE_FISHEYE": (FISHEYE, ("f", "cx", "cy")),
    "FISHEYE": (FISHEYE, ("fx", "fy", "cx", "cy")),
    "SIMPLE_RADIAL_FISHEYE": (FISHEYE, ("f", "cx", "cy", "k1")),
    "RADIAL_FISHEYE": (FISHEYE, ("f", "cx", "cy", "k1", "k2")),
    "THIN_PRISM_FISHEYE": (THIN_PRISM_FISHEYE, ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "sx1", "sy1")),
    "FOV": (FIELD_OF_VIEW, ("fx", "fy", "cx", "cy", "omega")),
}
STRAIGHT = 1e-6  # radians of an omega, with which FOV is a pinhole up to rounding


@public_call
@passing_on(SensorAttributes.__annotations__, sensor_of)
def cameras_from_colmap(folder: str | os.PathLike, *, scale: float = 1.0,
                        **attributes: Unpack[SensorAttributes]) -> dict[str, Calibrated]:
    """The sensors `calibrated` of a COLMAP model, by the name of their image and in the order of the file.

        cameras = rb.cameras_from_colmap("sparse/0", scale=0.25)
        scene = rb.load_dict({"type": "scene", **cameras, ...})

    The world is COLMAP's. Its pixels are counted from the corner of the image, ours from the centre of the first pixel: cx
    and cy become less by 0.5. Points are not read.

    Args:
        folder: with cameras.txt and images.txt; or, without these, cameras.bin and images.bin.
        scale, **attributes: as of `camera_from_opencv`.

    Raises:
        SceneError: names file and line, or record, of what cannot be read, and the camera models that are supported.
        FileNotFoundError: if there is no such file.
    """
    folder = Path(folder)
    is_binary = not (folder / "cameras.txt").exists() and (folder / "cameras.bin").exists()
    of_cameras, of_images = (folder / f"{name}{'.bin' if is_binary else '.txt'}" for name in ("cameras", "images"))
    cameras = read_cameras(records(of_cameras, binary_cameras(of_cameras)) if is_binary else lines_of(of_cameras))
    sensors: dict[str, Calibrated] = {}
    for line, pose, camera, name in read_images(
            records(of_images, binary_images(of_images)) if is_binary else image_lines(of_images)):
        if camera not in cameras:
            raise line.fail(f"no camera has the id {camera}; {of_cameras.name} has {', '.join(cameras) or 'none'}")
        if name in sensors:
            raise line.fail(f"a second image is called {name!r}")
        sensors[name] = sensor_of(cameras[camera], pose, scale, **attributes)
    if not sensors:
        raise SceneError(f"{of_images}: has no image")
    return sensors


class Line(NamedTuple):
    """A line of a COLMAP text file, or a record of a binary one, as words."""

    path: Path
    number: int
    words: list[str]
    unit: str = "line"

    def fail(self, message: str) -> SceneError:
        """The error about this line or record, to be raised."""
        return SceneError(f"{self.path}, {self.unit} {self.number}: {message}")

    def numbers(self, first: int, last: int, what: str) -> list[float]:
        """The words from `first` to before `last` as finite numbers."""
        try:
            values = [float(word) for word in self.words[first:last]]
        except ValueError:
            values = [math.nan]
        if not all(abs(value) < LARGEST for value in values):
            raise self.fail(f"{what} must be finite numbers, got {' '.join(self.words[first:last])[:80]!r}")
        return values


def lines_of(path: Path) -> Iterator[Line]:
    """Yields the lines of a text file without comments; blank ones have no words."""
    with opened(path) as file:
        for number, text in enumerate(file, 1):
            text = text.removeprefix(BYTE_ORDER_MARK) if number == 1 else text
            if text.lstrip().startswith(b"#"):
                continue
            try:
                yield Line(path, number, text.decode().split())
            except UnicodeDecodeError:
                raise SceneError(f"{path}, line {number}: is no text; is the file binary?") from None


def records(path: Path, numbered: Iterable[tuple[int, list[str]]]) -> Iterator[Line]:
    """Wraps the records of a binary file as lines."""
    return (Line(path, number, words, "record") for number, words in numbered)


def read_cameras(lines: Iterable[Line]) -> dict[str, Intrinsics]:
    """Reads the intrinsics of cameras, by id, from lines CAMERA_ID MODEL WIDTH HEIGHT PARAMETERS."""
    cameras = {}
    for line in lines:
        if not line.words:
            continue
        if len(line.words) < 4:
            raise line.fail(f"expected CAMERA_ID MODEL WIDTH HEIGHT and parameters, got {' '.join(line.words)!r}")
        name, model = line.words[:2]
        if model not in MODELS:
            raise line.fail(f"the camera model {model} is not supported; {nearest(model, MODELS)}")
        if name in cameras:
            raise line.fail(f"a second camera has the id {name}")
        lens, parameters = MODELS[model]
        if len(line.words) != 4 + len(parameters):
            raise line.fail(f"{model} has the parameters {' '.join(parameters)}, got {len(line.words) - 4} numbers")
        size = line.numbers(2, 4, "width and height")
        if min(size) < 1 or any(side != int(side) for side in size):
            raise line.fail(f"width and height must be whole numbers of at least 1, got {' '.join(line.words[2:4])}")
        if size[0] * size[1] > MAX_PIXELS:
            raise line.fail(f"an image may have 1 to {MAX_PIXELS} pixels, this one has {size[0]:g} x {size[1]:g}")
        values = dict(zip(parameters, line.numbers(4, None, "parameters")))
        focal = [values.pop(key, None) for key in ("fx", "fy")]
        fx, fy = [values.pop("f")] * 2 if "f" in values else focal
        if min(fx, fy) < SMALLEST:
            raise line.fail(f"focal lengths must be greater than 0, got {min(fx, fy):g}")
        cx, cy = values.pop("cx") - 0.5, values.pop("cy") - 0.5
        if "omega" in values:  # of either sign, or 0: the formula is even
            if not abs(values["omega"]) < math.pi:
                raise line.fail(f"omega must be less than pi radians, got {values['omega']:g}")
            values["omega"] = max(abs(values["omega"]), STRAIGHT)
        cameras[name] = Intrinsics(int(size[0]), int(size[1]), fx, fy, cx, cy, model=lens, coefficients=values)
    return cameras


def image_lines(path: Path) -> Iterator[Line]:
    """Yields the lines of images in a text file, skipping the line of points after each, which may be blank."""
    of_points = False
    for line in lines_of(path):
        if of_points:
            of_points = False
            if len(line.words) % 3:
                raise line.fail("expected the points of the image before, X Y POINT3D_ID each, or a blank line")
            continue
        if line.words:
            yield line
            of_points = True


def read_images(lines: Iterable[Line]) -> Iterator[tuple[Line, np.ndarray, str, str]]:
    """Yields each image's line, `to_world`, camera id and name: IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME."""
    for line in lines:
        if len(line.words) < 10:
            raise line.fail(f"expected IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, got {' '.join(line.words)[:80]!r}")
        name = " ".join(line.words[9:])
        if not name.strip("."):
            raise line.fail(f"an image must have a name, got {name!r}; is the file damaged?")
        values = line.numbers(1, 8, "rotation and translation")
        if not 1e-6 < np.linalg.norm(values[:4]) < 1e6:
            raise line.fail(f"the rotation must be a quaternion of length 1, got {values[:4]}")
        yield line, pose_of(_rotation(np.array(values[:4])), np.array(values[4:])), line.words[8], name


def _rotation(quaternion: np.ndarray) -> np.ndarray:
    """The (3, 3) rotation matrix of a quaternion w, x, y, z of any length."""
    w, x, y, z = quaternion / np.linalg.norm(quaternion)
    return np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                     [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                     [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]])
