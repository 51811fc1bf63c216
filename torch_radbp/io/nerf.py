"""Reads the cameras of a NeRF data set: transforms.json, as instant-ngp, nerfstudio and the Blender scenes write it."""

from __future__ import annotations

import json
import math
import os
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from torch_radbp.formats.files import opened
from torch_radbp.io.opencv import FROM_OPENGL, LARGEST, ORTHOGONAL, SMALLEST, Intrinsics, sensor_of
from torch_radbp.plugin import ReconstructionFilter, SceneError, nearest
from torch_radbp.public_call import public_call
from torch_radbp.sensor.calibrated import BROWN_CONRADY, FISHEYE, Calibrated

INTRINSICS = ("w", "h", "fl_x", "fl_y", "cx", "cy", "camera_angle_x", "camera_angle_y", "k1", "k2", "k3", "k4", "p1", "p2",
              "camera_model", "is_fisheye")
LENSES = {"OPENCV": BROWN_CONRADY, "PINHOLE": BROWN_CONRADY, "SIMPLE_PINHOLE": BROWN_CONRADY, "OPENCV_FISHEYE": FISHEYE}
COEFFICIENTS = {"OPENCV": ("k1", "k2", "k3", "p1", "p2"), "OPENCV_FISHEYE": ("k1", "k2", "k3", "k4")}
# Keys that say nothing of a camera: those of training, of the scene's extent, of files beside.
WITHOUT_EFFECT = ("frames", "file_path", "transform_matrix", "rotation", "sharpness", "aabb_scale", "aabb", "scale",
                  "offset", "up", "n_frames", "applied_transform", "applied_scale", "ply_file_path",
                  "mask_path", "depth_file_path", "colmap_im_id", "time", "train_filenames",
                  "val_filenames", "test_filenames", "orientation_override")


@public_call
def cameras_from_nerf(path: str | os.PathLike, *, width: int | None = None, height: int | None = None, scale: float = 1.0,
                      rfilter: ReconstructionFilter | str | None = None, **attributes: Any) -> dict[str, Calibrated]:
    """The sensors `calibrated` of a NeRF data set, by the `file_path` of their image (without "./") and in its order.

        scene = rb.load_dict({"type": "scene", **rb.cameras_from_nerf("lego/transforms_train.json"), ...})

    Read are, for all frames or for each: `camera_angle_x`, `camera_angle_y`, `fl_x`, `fl_y`, `cx`, `cy`, `w`, `h`,
    `k1`, `k2`, `k3`, `p1`, `p2`, of a fisheye `k1` to `k4`, `camera_model` (OPENCV, OPENCV_FISHEYE, PINHOLE, SIMPLE_PINHOLE)
    or `is_fisheye`, and `transform_matrix`, camera to world with OpenGL's axes. The world is the file's, in
    which z points up as a rule: an `envmap`, whose pole is y, is turned by `to_world=[[1, 0, 0, 0], [0, 0, -1, 0],
    [0, 1, 0, 0], [0, 0, 0, 1]]`, and a `sunsky` has its zenith at z anyway. Pixels are counted from the corner of the image,
    ours from the centre of the first pixel: cx and cy become less by 0.5.

    Args:
        path: of the .json file.
        width, height: of images whose size neither the file says nor the image beside it.
        scale, rfilter, **attributes: as of `camera_from_opencv`.

    Raises:
        SceneError: names the file and the entry (or the line, if it is no JSON), and what is supported.
        FileNotFoundError: if there is no such file.
    """
    path = Path(path)
    document = read_json(path)
    frames = document.get("frames")
    if not isinstance(frames, list) or not frames:
        raise SceneError(f"{path}: must have \"frames\", a list with one object for each image, got {frames!r:.80}")
    found: dict[str, Calibrated] = {}
    unknown: set[str] = set(document)
    for number, frame in enumerate(frames):
        place = f"{path}: frames[{number}]"
        if not isinstance(frame, dict):
            raise SceneError(f"{place}: must be an object, got {frame!r:.80}")
        unknown |= set(frame)
        name = frame.get("file_path")
        if not isinstance(name, str) or not name:
            raise SceneError(f"{place}.file_path: must be the name of the image, got {name!r:.80}")
        name = name.removeprefix("./")
        if name in found:
            raise SceneError(f"{place}.file_path: a second frame has the image {name!r}")
        given = {key: source[key] for source in (document, frame) for key in INTRINSICS if key in source}
        size = size_of(place, given, path.parent, name, (width, height))
        found[name] = sensor_of(intrinsics(place, given, size), pose(place, frame), scale, rfilter, attributes)
        found[name].up = (0.0, 0.0, 1.0)
    unknown -= {*INTRINSICS, *WITHOUT_EFFECT}
    if unknown:
        warnings.warn(f"{path}: not read: {', '.join(sorted(unknown))}; read are {', '.join(INTRINSICS)}, file_path and "
                      f"transform_matrix", stacklevel=3)
    return found


def read_json(path: Path) -> dict[str, Any]:
    """The object in a JSON file."""
    with opened(path) as file:
        content = file.read()
    try:
        document = json.loads(content)
    except json.JSONDecodeError as error:
        raise SceneError(f"{path}, line {error.lineno}: is no JSON: {error.msg}") from None
    except (UnicodeDecodeError, RecursionError, ValueError) as error:
        raise SceneError(f"{path}: is no JSON: {error}") from None
    if not isinstance(document, dict):
        raise SceneError(f"{path}: must be a JSON object with \"frames\", got a {type(document).__name__}")
    return document


def number(place: str, given: dict[str, Any], key: str) -> float | None:
    """The finite number under a key, or None."""
    value = given.get(key)
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) < LARGEST:
        raise SceneError(f"{place}: {key} must be a finite number, got {value!r:.80}")
    return float(value)


def size_of(place: str, given: dict[str, Any], folder: Path, name: str, other: tuple[int | None, int | None]) -> list[int]:
    """Width and height as the file says them, or the image does, or the caller."""
    size = [number(place, given, key) for key in ("w", "h")]
    if None in size:
        image = image_of(folder, name)
        size = list(other) if None not in other else size_of_image(image) if image is not None else [None]
    if None in size:
        raise SceneError(f"{place}: the size of the image is not known: neither w and h are given nor is there a file "
                         f"{name}; give width= and height=")
    if min(size) < 1 or any(side != int(side) for side in size):
        raise SceneError(f"{place}: w and h must be whole numbers of at least 1, got {size}")
    return [int(side) for side in size]


def image_of(folder: Path, name: str) -> Path | None:
    """The file of an image, whose name may lack its extension; None if there is none."""
    images = [folder / f"{name}{suffix}" for suffix in ("", ".png", ".jpg")]
    return next((image for image in images if image.is_file()), None)


def size_of_image(path: Path) -> list[int]:
    """Width and height of a picture, from its header."""
    try:
        with Image.open(path, formats=("PNG", "JPEG")) as file:
            return list(file.size)
    except (OSError, SyntaxError, ValueError) as error:
        raise SceneError(f"{path}: its size cannot be read: {error}; give width= and height=") from error


def intrinsics(place: str, given: dict[str, Any], size: list[int]) -> Intrinsics:
    """What a frame says of its camera, with what is said of all."""
    fisheye = given.get("is_fisheye", False)
    if not isinstance(fisheye, bool):
        raise SceneError(f"{place}: is_fisheye must be true or false, got {fisheye!r:.80}")
    model = given.get("camera_model", "OPENCV_FISHEYE" if fisheye else "OPENCV")
    if not isinstance(model, str) or model not in LENSES:
        raise SceneError(f"{place}: camera_model {model!r:.80} is not supported; {nearest(str(model)[:80], LENSES)}")
    (width, height), focal = size, []
    for key, angle, side in (("fl_x", "camera_angle_x", width), ("fl_y", "camera_angle_y", height)):
        length, wide = number(place, given, key), number(place, given, angle)
        if length is None and wide is not None:
            if not 0 < wide < math.pi:
                raise SceneError(f"{place}: {angle} must be between 0 and pi radians, got {wide:g}")
            length = 0.5 * side / math.tan(0.5 * wide)
        if length is not None and not SMALLEST <= length < LARGEST:
            raise SceneError(f"{place}: {key} must be greater than 0 and finite, got {length:g}")
        focal.append(length)
    if focal == [None, None]:
        raise SceneError(f"{place}: the focal length is missing: give fl_x (pixels) or camera_angle_x (radians)")
    fx, fy = (own if own is not None else other for own, other in (focal, reversed(focal)))
    cx, cy = (0.5 * side if middle is None else middle
              for side, middle in ((width, number(place, given, "cx")), (height, number(place, given, "cy"))))
    known = COEFFICIENTS.get(model, ())
    values = {key: number(place, given, key) for key in ("k1", "k2", "k3", "k4", "p1", "p2")}
    stray = [key for key, value in values.items() if value and key not in known]
    if stray:
        raise SceneError(f"{place}: {stray[0]} = {values[stray[0]]:g} is no coefficient of the camera_model {model}; "
                         f"known: {', '.join(known) or 'none'}")
    coefficients = {key: values[key] for key in known if values[key] is not None}
    return Intrinsics(width, height, fx, fy, cx - 0.5, cy - 0.5, model=LENSES[model], coefficients=coefficients)


def pose(place: str, frame: dict[str, Any]) -> np.ndarray:
    """(4, 4) float64 `to_world` of a frame."""
    try:
        matrix = np.array(frame.get("transform_matrix"), dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        matrix = np.zeros(0)
    if matrix.shape == (3, 4):
        matrix = np.concatenate([matrix, [[0, 0, 0, 1]]])
    if matrix.shape != (4, 4) or not (np.abs(matrix) < LARGEST).all() or np.abs(matrix[3] - (0, 0, 0, 1)).max() > 1e-6:
        raise SceneError(f"{place}.transform_matrix: must be a 4 x 4 matrix of finite numbers with the last row 0 0 0 1, "
                         f"got {frame.get('transform_matrix')!r:.120}")
    lengths = np.linalg.norm(matrix[:3, :3], axis=0)
    axes = matrix[:3, :3] / np.maximum(lengths, 1e-30)
    if np.abs(axes.T @ axes - np.eye(3)).max() > ORTHOGONAL or np.linalg.det(axes) < 0:
        raise SceneError(f"{place}.transform_matrix: its axes must be orthogonal and right-handed, got "
                         f"{matrix[:3, :3].tolist()}")
    matrix[:3, :3] = axes @ FROM_OPENGL
    return matrix
