"""Reads the cameras of a NeRF data set: transforms.json, as instant-ngp, nerfstudio and the Blender scenes write it."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Collection
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from typing_extensions import Unpack

from torch_radbp.formats.alpha import image_size
from torch_radbp.formats.files import opened
from torch_radbp.formats.image import READABLE
from torch_radbp.formats.leniency import Repairs
from torch_radbp.formats.memory import memory_for
from torch_radbp.formats.picture_size import MAX_PIXELS
from torch_radbp.io.opencv import FROM_OPENGL, LARGEST, ORTHOGONAL, SMALLEST, Intrinsics, SensorAttributes, sensor_of
from torch_radbp.plugin import SceneError, nearest
from torch_radbp.public_call import passing_on, public_call
from torch_radbp.sensor.calibrated import BROWN_CONRADY, FISHEYE, Calibrated

INTRINSICS = ("w", "h", "fl_x", "fl_y", "cx", "cy", "camera_angle_x", "camera_angle_y", "k1", "k2", "k3", "k4", "p1", "p2",
              "camera_model", "is_fisheye")
TOGETHER = (("fl_x", "fl_y", "camera_angle_x", "camera_angle_y"), ("camera_model", "is_fisheye"))  # which say one thing
LENSES = {"OPENCV": BROWN_CONRADY, "PINHOLE": BROWN_CONRADY, "SIMPLE_PINHOLE": BROWN_CONRADY, "SIMPLE_RADIAL": BROWN_CONRADY,
          "RADIAL": BROWN_CONRADY, "OPENCV_FISHEYE": FISHEYE, "SIMPLE_RADIAL_FISHEYE": FISHEYE, "RADIAL_FISHEYE": FISHEYE}
COEFFICIENTS = {"OPENCV": ("k1", "k2", "k3", "p1", "p2"), "OPENCV_FISHEYE": ("k1", "k2", "k3", "k4"),
                "SIMPLE_RADIAL": ("k1",), "RADIAL": ("k1", "k2"), "SIMPLE_RADIAL_FISHEYE": ("k1",),
                "RADIAL_FISHEYE": ("k1", "k2")}
# Keys that say nothing of a camera: those of training, of the scene's extent, of files beside.
WITHOUT_EFFECT = ("frames", "file_path", "transform_matrix", "rotation", "sharpness", "aabb_scale", "aabb", "scale",
                  "offset", "up", "n_frames", "applied_transform", "applied_scale", "ply_file_path",
                  "mask_path", "depth_file_path", "colmap_im_id", "time", "train_filenames",
                  "val_filenames", "test_filenames", "orientation_override")
SKEWED = 1e-2  # cosine of the angle between axes up to which they are made orthogonal
EXACT = 1e-6  # and up to which they are
SUFFIXES = (".png", ".jpg", *READABLE, *(suffix.upper() for suffix in READABLE))  # that the name of an image may lack
MISSING = ("skip", "error")


@public_call
@passing_on(SensorAttributes.__annotations__, sensor_of)
def cameras_from_nerf(path: str | os.PathLike, *, width: int | None = None, height: int | None = None, scale: float = 1.0,
                      missing: str = "skip", strict: bool = False,
                      **attributes: Unpack[SensorAttributes]) -> dict[str, Calibrated]:
    """The sensors `calibrated` of a NeRF data set, by the `file_path` of their image (without "./") and in its order.

        cameras = rb.cameras_from_nerf("lego/transforms_train.json")
        scene = rb.load_dict({"type": "scene", **cameras, ...})

    Read are, for all frames or for each, whose values win: `camera_angle_x`, `camera_angle_y`, `fl_x`, `fl_y`, `cx`, `cy`,
    `w`, `h`, `k1`, `k2`, `k3`, `p1`, `p2`, of a fisheye `k1` to `k4`, `camera_model` (OPENCV, RADIAL, SIMPLE_RADIAL,
    PINHOLE, SIMPLE_PINHOLE, OPENCV_FISHEYE, RADIAL_FISHEYE, SIMPLE_RADIAL_FISHEYE) or `is_fisheye`, and `transform_matrix`,
    camera to world with OpenGL's axes. A frame that says anything of its focal lengths says all of them. The world is the
    file's, in which z points up as a rule: an `envmap`, whose pole is y, is turned by `to_world=[[1, 0, 0, 0],
    [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]]`, and a `sunsky` has its zenith at z anyway. Pixels are counted from the
    corner of the image, ours from the centre of the first pixel: cx and cy become less by 0.5.

    Axes that are skewed by up to half a degree are made orthogonal, with a warning that says by how much.

    Args:
        path: of the .json file.
        width, height: of images whose size neither the file says nor the image beside it.
        scale, **attributes: as of `camera_from_opencv`.
        missing: what to do with frames whose size only their image could say, which is not there: "skip" them, with a
            warning, or "error".
        strict: raise errors instead of warnings of what is left out or repaired.

    Raises:
        SceneError: names the file and the entry (or the line, if it is no JSON), and what is supported.
        FileNotFoundError: if there is no such file.
    """
    with Repairs(strict):
        return nerf_cameras(Path(path), None, width=width, height=height, scale=scale, missing=missing, **attributes)


def nerf_cameras(path: Path, names: Collection[str] | None, *, width: int | None = None, height: int | None = None,
                 scale: float = 1.0, missing: str = "skip",
                 **attributes: Unpack[SensorAttributes]) -> dict[str, Calibrated]:
    """Reads the cameras of some frames, or of all; arguments and errors as of `cameras_from_nerf`."""
    missing_of(missing)
    document = read_json(path)
    frames = [frame for frame in frames_of(path, document) if names is None or frame.name in names]
    given = {frame.name: given_of(document, frame) for frame in frames}
    sizes = {frame.name: _size_of(frame, given[frame.name], path.parent, (width, height)) for frame in frames}
    absent = [frame for frame in frames if sizes[frame.name] is None]
    if absent and (missing == "error" or len(absent) == len(frames)):
        raise SceneError(f"{absent[0].place}: the size of the image is not known: neither w and h are given nor is there a "
                         f"file {absent[0].name} in {path.parent}; give width= and height=")
    cameras: dict[str, Calibrated] = {}
    with Repairs() as repairs:
        for frame in frames:
            size = sizes[frame.name]
            if size is None:
                repairs.add(frame.name, left_out(path))
                continue
            camera = sensor_of(intrinsics(frame, given[frame.name], size), pose(frame), scale, **attributes)
            camera.up = (0.0, 0.0, 1.0)
            cameras[frame.name] = camera
        for key in sorted({*document}.union(*(frame.entry for frame in frames)) - {*INTRINSICS, *WITHOUT_EFFECT}):
            repairs.add(key, f"not read in {path}; read are {', '.join(INTRINSICS)}, file_path and transform_matrix")
    return cameras


def left_out(path: str | os.PathLike) -> str:
    """The warning about images of a data set that are missing."""
    return f"left out of {path}: the image is not there (missing=\"error\" insists on all)"


def missing_of(missing: str) -> str:
    """Checks the option `missing`, what to do with missing images, and returns it."""
    if missing not in MISSING:
        raise ValueError(f"missing must be {' or '.join(map(repr, MISSING))}, got {missing!r:.60}")
    return missing


class NerfFrame(NamedTuple):
    """A frame of a NeRF data set: an entry of "frames"."""

    path: Path  # of the document
    place: str  # in it, for messages
    name: str  # file_path, without "./"
    entry: dict[str, Any]


def frames_of(path: Path, document: dict[str, Any]) -> list[NerfFrame]:
    """The frames of a document, whose names all differ.

    Raises:
        SceneError: names the frame that is none.
    """
    entries = document.get("frames")
    if not isinstance(entries, list) or not entries:
        raise SceneError(f"{path}: must have \"frames\", a list with one object for each image, got {entries!r:.80}")
    frames: dict[str, NerfFrame] = {}
    for number, entry in enumerate(entries):
        place = f"{path}: frames[{number}]"
        if not isinstance(entry, dict):
            raise SceneError(f"{place}: must be an object, got {entry!r:.80}")
        name = entry.get("file_path")
        if not isinstance(name, str) or not name:
            raise SceneError(f"{place}.file_path: must be the name of the image, got {name!r:.80}")
        name = name.removeprefix("./")
        if name in frames:
            raise SceneError(f"{place}.file_path: a second frame has the image {name!r}")
        frames[name] = NerfFrame(path, place, name, entry)
    return list(frames.values())


def given_of(document: dict[str, Any], frame: NerfFrame) -> dict[str, Any]:
    """The camera entries of a frame: those in the frame, else those for the whole document."""
    of_frame = {key: frame.entry[key] for key in INTRINSICS if frame.entry.get(key) is not None}
    said = {*of_frame}.union(*(keys for keys in TOGETHER if any(key in of_frame for key in keys)))
    return of_frame | {key: document[key] for key in INTRINSICS if document.get(key) is not None and key not in said}


def read_json(path: Path) -> dict[str, Any]:
    """Reads a JSON file that contains an object."""
    try:
        with opened(path) as file, memory_for(path):
            document = json.loads(file.read())
    except json.JSONDecodeError as error:
        raise SceneError(f"{path}, line {error.lineno}: is no JSON: {error.msg}") from None
    except (UnicodeDecodeError, RecursionError, ValueError) as error:
        raise SceneError(f"{path}: is no JSON: {error}") from None
    if not isinstance(document, dict):
        raise SceneError(f"{path}: must be a JSON object with \"frames\", got a {type(document).__name__}")
    return document


def _number(place: str, given: dict[str, Any], key: str) -> float | None:
    """The finite number under a key, or None."""
    value = given.get(key)
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) < LARGEST:
        raise SceneError(f"{place}: {key} must be a finite number, got {value!r:.80}")
    return float(value)


def _size_of(frame: NerfFrame, given: dict[str, Any], folder: Path,
             other: tuple[int | None, int | None]) -> list[int] | None:
    """Width and height from the file, the caller or the image; None if that is missing."""
    size = [_number(frame.place, given, key) for key in ("w", "h")]
    if None in size:
        image = image_file(folder, frame.name)
        if None in other and image is None:
            return None
        size = list(other) if None not in other else size_of_image(image)
    if min(size) < 1 or any(side != int(side) for side in size):
        raise SceneError(f"{frame.place}: w and h must be whole numbers of at least 1, got {size}")
    if size[0] * size[1] > MAX_PIXELS:
        raise SceneError(f"{frame.place}: an image may have 1 to {MAX_PIXELS} pixels, w and h are {size[0]:g} and "
                         f"{size[1]:g}")
    return [int(side) for side in size]


def image_file(folder: Path, name: str) -> Path | None:
    """The file of an image, whose name may lack its extension, or have backslashes; None if there is none."""
    suffixes = ("",) if Path(name).suffix.lower() in READABLE else ("", *SUFFIXES)  # view.jpg.png is the mask of view.jpg
    images = [folder / f"{each}{suffix}" for each in (name, name.replace("\\", "/")) for suffix in suffixes]
    return next((image for image in images if is_file(image)), None)


def is_file(path: Path) -> bool:
    """True if there is such a file; False for names that no file can have."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def size_of_image(path: Path) -> list[int]:
    """Width and height of an image, from its header."""
    try:
        return list(image_size(path))
    except (OSError, ValueError) as error:
        raise SceneError(f"{path}: its size cannot be read: {error}; give width= and height=") from error


def intrinsics(frame: NerfFrame, given: dict[str, Any], size: list[int]) -> Intrinsics:
    """The intrinsics of a frame's camera."""
    place, fisheye = frame.place, given.get("is_fisheye")
    if fisheye is not None and not isinstance(fisheye, bool):
        raise SceneError(f"{place}: is_fisheye must be true or false, got {fisheye!r:.80}")
    model = given.get("camera_model", "OPENCV_FISHEYE" if fisheye else "OPENCV")
    if not isinstance(model, str) or model not in LENSES:
        raise SceneError(f"{place}: camera_model {model!r:.80} is not supported; {nearest(str(model)[:80], LENSES)}")
    if fisheye is not None and fisheye != (LENSES[model] == FISHEYE):
        with Repairs() as repairs:
            repairs.add(frame.name, f"camera_model {model} counts in {frame.path}, not is_fisheye {str(fisheye).lower()} "
                                    f"beside it")
    (width, height), focal = size, []
    for key, angle, side in (("fl_x", "camera_angle_x", width), ("fl_y", "camera_angle_y", height)):
        length, wide = _number(place, given, key), _number(place, given, angle)
        if length is None and wide is not None:
            if not 0 < wide < math.pi:
                raise SceneError(f"{place}: {angle} must be between 0 and pi radians, got {wide:g}")
            length = 0.5 * side / math.tan(0.5 * wide)
        if length is not None and not SMALLEST <= length < LARGEST:
            raise SceneError(f"{place}: {key} must be greater than 0 and finite, got {length:g}")
        focal.append(length)
    if focal == [None, None]:
        raise SceneError(f"{place}: the focal length is missing: give fl_x (pixels) or camera_angle_x (radians)")
    fx, fy = (along_axis if along_axis is not None else other for along_axis, other in (focal, reversed(focal)))
    cx, cy = (0.5 * side if middle is None else middle
              for side, middle in ((width, _number(place, given, "cx")), (height, _number(place, given, "cy"))))
    names = COEFFICIENTS.get(model, ())
    values = {key: _number(place, given, key) for key in ("k1", "k2", "k3", "k4", "p1", "p2")}
    stray = [key for key, value in values.items() if value and key not in names]
    if stray:
        raise SceneError(f"{place}: {stray[0]} = {values[stray[0]]:g} is no coefficient of the camera_model {model}; "
                         f"known: {', '.join(names) or 'none'}")
    coefficients = {key: values[key] for key in names if values[key] is not None}
    return Intrinsics(width, height, fx, fy, cx - 0.5, cy - 0.5, model=LENSES[model], coefficients=coefficients)


def pose(frame: NerfFrame) -> np.ndarray:
    """(4, 4) float64 `to_world` of a frame."""
    place, given = frame.place, frame.entry.get("transform_matrix")
    try:
        matrix = np.array(given, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        matrix = np.zeros(0)
    if matrix.shape == (3, 4):
        matrix = np.concatenate([matrix, [[0, 0, 0, 1]]])
    if matrix.shape != (4, 4) or not (np.abs(matrix) < LARGEST).all() or np.abs(matrix[3] - (0, 0, 0, 1)).max() > 1e-6:
        raise SceneError(f"{place}.transform_matrix: must be a 4 x 4 matrix of finite numbers with the last row 0 0 0 1, "
                         f"got {given!r:.120}")
    lengths = np.linalg.norm(matrix[:3, :3], axis=0)
    axes = matrix[:3, :3] / np.maximum(lengths, 1e-30)
    skewed = np.abs(axes.T @ axes - np.eye(3)).max()
    if skewed > SKEWED or np.linalg.det(axes) < 0:
        raise SceneError(f"{place}.transform_matrix: its axes must be orthogonal and right-handed, got "
                         f"{matrix[:3, :3].tolist()}")
    if skewed > EXACT:
        left, _, right = np.linalg.svd(axes)
        axes = left @ right  # the nearest rotation
    if skewed > ORTHOGONAL:
        with Repairs() as repairs:
            repairs.add(f"{frame.name} ({math.degrees(math.asin(skewed)):.2g} degrees)",
                        f"the axes of transform_matrix in {frame.path} are skewed, and made orthogonal")
    matrix[:3, :3] = axes @ FROM_OPENGL
    return matrix
