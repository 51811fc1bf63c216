"""Calibrated cameras from the matrices of computer vision: K, R and t, or kornia's."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor
from typing_extensions import Unpack

from torch_radbp.film.hdrfilm import HDRFilm
from torch_radbp.plugin import REGISTRY, ReconstructionFilter, boolean, integer, nearest, no_gradient, positive
from torch_radbp.public_call import passing_on, public_call
from torch_radbp.sensor.calibrated import BROWN_CONRADY, FISHEYE, Calibrated, CameraAttributes

ORDER = {BROWN_CONRADY: ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"), FISHEYE: ("k1", "k2", "k3", "k4")}
LENGTHS = {BROWN_CONRADY: (0, 4, 5, 8), FISHEYE: (0, 4)}  # of OpenCV's vectors of coefficients
ORTHOGONAL = 1e-3  # how far the product of a rotation and its transpose may be from the unit matrix
SMALLEST, LARGEST = 1e-30, 1e30  # numbers of a file that float32 has, also once they are scaled
FROM_OPENCV = np.diag([-1.0, -1.0, 1.0])  # our x and y point to the left and up, OpenCV's to the right and down
FROM_OPENGL = np.diag([-1.0, 1.0, -1.0])  # where x points to the right, y up and z back


class Intrinsics(NamedTuple):
    """The intrinsics and distortion of a calibrated camera; pixels, from the centre of the first one."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    skew: float = 0.0
    model: str = BROWN_CONRADY
    coefficients: dict[str, float] = {}


class SensorAttributes(CameraAttributes, total=False):
    """Keyword arguments for sensors made from calibrations, which themselves do not contain these."""

    rfilter: ReconstructionFilter | str | None


@passing_on(CameraAttributes.__annotations__, Calibrated.__init__)
def sensor_of(camera: Intrinsics, to_world: np.ndarray, scale: float,
              rfilter: ReconstructionFilter | str | None = None, **attributes: Unpack[CameraAttributes]) -> Calibrated:
    """Builds a sensor from intrinsics and a pose, its image scaled to whole pixels."""
    width, height = (max(1, round(size * positive("scale", scale))) for size in (camera.width, camera.height))
    x, y = width / camera.width, height / camera.height
    film = HDRFilm(width=width, height=height, rfilter=filter_of(rfilter))
    return Calibrated(
        fx=camera.fx * x, fy=camera.fy * y, cx=(camera.cx + 0.5) * x - 0.5, cy=(camera.cy + 0.5) * y - 0.5,
        skew=camera.skew * x, distortion=camera.model, **camera.coefficients,
        to_world=torch.from_numpy(to_world), film=film, **attributes)


@public_call
@passing_on(SensorAttributes.__annotations__, sensor_of)
def camera_from_opencv(K: Any, R: Any, t: Any, width: int, height: int, distortion: Sequence[float] = (),
                       fisheye: bool = False, *, scale: float = 1.0,
                       **attributes: Unpack[SensorAttributes]) -> Calibrated:
    """The sensor `calibrated` of a camera as OpenCV describes it: x = K (R X + t).

        camera = rb.camera_from_opencv(K, R, t, 640, 480, distortion)
        scene = rb.load_dict({"type": "scene", "camera": camera, ...})

    Args:
        K: (3, 3) fx, skew, cx; 0, fy, cy; 0, 0, 1, in pixels. (0, 0) is the centre of the upper left pixel.
        R: (3, 3) rotation from the world to the camera, whose x points to the right, y down and z ahead.
        t: (3,) or (3, 1) the world's origin as the camera sees it.
        width, height: of the image, pixels.
        distortion: k1, k2, p1, p2[, k3[, k4, k5, k6]] or of a fisheye k1, k2, k3, k4; those given are parameters.
        fisheye: whether that is a Kannala-Brandt lens.
        scale: of the image that is rendered, 0.25 for a quarter of the width and of the height.
        **attributes: near_clip, far_clip and sampler of the sensor; rfilter of its film, or its name, such as "box",
            Gaussian by default.

    Raises:
        ValueError: if a shape or a matrix is not as said, or has a gradient, which would not reach it.
    """
    return sensor_of(intrinsics_of(K, width, height, distortion, fisheye), pose_of(R, t), scale, **attributes)


@public_call
@passing_on(SensorAttributes.__annotations__, sensor_of)
def cameras_from_kornia(pinhole: Any, *, scale: float = 1.0,
                        **attributes: Unpack[SensorAttributes]) -> list[Calibrated]:
    """The sensors `calibrated` of a `kornia.geometry.camera.PinholeCamera`, one for each of its batch.

    Its pixels are OpenCV's, its extrinsics lead from the world to the camera.

    Args:
        pinhole: with intrinsics and extrinsics (B, 4, 4), height and width (B,).
        scale, **attributes: as of `camera_from_opencv`.

    Raises:
        TypeError: if it is no such camera.
        ValueError: as `camera_from_opencv`.
    """
    parts = [getattr(pinhole, name, None) for name in ("intrinsics", "extrinsics", "width", "height")]
    if not all(isinstance(part, Tensor) for part in parts):
        raise TypeError(f"pinhole must be a kornia.geometry.camera.PinholeCamera, got {type(pinhole).__name__}")
    intrinsics, extrinsics, *sizes = parts
    for name, value in (("intrinsics", intrinsics), ("extrinsics", extrinsics)):
        if value.ndim != 3 or value.shape[1:] != (4, 4):
            raise ValueError(f"the {name} of pinhole must have shape (B, 4, 4), got {tuple(value.shape)}")
    extrinsics = array("extrinsics", extrinsics, tuple(extrinsics.shape))
    widths, heights = ([whole("width" if side == 0 else "height", value) for value in size.flatten()]
                       for side, size in enumerate(sizes))
    return [camera_from_opencv(K[:3, :3], E[:3, :3], E[:3, 3], width, height, scale=scale, **attributes)
            for K, E, width, height in zip(intrinsics, extrinsics, widths, heights)]


def whole(name: str, value: Tensor) -> int:
    """Converts a tensor with one whole number, of any dtype, to an int."""
    number = value.item()
    if number != int(number):
        raise ValueError(f"the {name} of pinhole must be whole numbers, got {number}")
    return int(number)


def intrinsics_of(K: Any, width: int, height: int, distortion: Sequence[float], fisheye: bool) -> Intrinsics:
    """The record of intrinsics from K and OpenCV's distortion vector; raises as `camera_from_opencv`."""
    matrix = array("K", K, (3, 3))
    if matrix[1, 0] != 0 or (matrix[2] != (0, 0, 1)).any():
        raise ValueError(f"K must be fx, skew, cx; 0, fy, cy; 0, 0, 1, got {matrix.tolist()}")
    model = FISHEYE if boolean("fisheye", fisheye) else BROWN_CONRADY
    values = array("distortion", distortion, None).flatten()
    if len(values) not in LENGTHS[model]:
        raise ValueError(f"distortion must have {' or '.join(map(str, LENGTHS[model]))} coefficients "
                         f"({', '.join(ORDER[model])}), got {len(values)}")
    return Intrinsics(integer("width", width, 1), integer("height", height, 1), *matrix[[0, 1, 0, 1], [0, 1, 2, 2]].tolist(),
                      skew=float(matrix[0, 1]), model=model, coefficients=dict(zip(ORDER[model], values.tolist())))


def pose_of(R: Any, t: Any) -> np.ndarray:
    """(4, 4) float64 `to_world` from a camera's rotation and translation, world to camera; ValueError if these are none."""
    rotation, translation = array("R", R, (3, 3)), array("t", t, None)
    if translation.shape not in ((3,), (3, 1)):
        raise ValueError(f"t must have shape (3,) or (3, 1), got {translation.shape}")
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > ORTHOGONAL or np.linalg.det(rotation) < 0:
        raise ValueError(f"R must be a rotation, orthogonal and with determinant 1, got {rotation.tolist()}")
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation.T @ FROM_OPENCV, -rotation.T @ translation.reshape(3)
    return pose


def filter_of(rfilter: ReconstructionFilter | str | None) -> ReconstructionFilter | None:
    """A reconstruction filter, given itself or by name.

    Raises:
        ValueError: on unknown names.
        TypeError: if it is neither.
    """
    if rfilter is None or isinstance(rfilter, ReconstructionFilter):
        return rfilter
    filters = REGISTRY["rfilter"]
    if not isinstance(rfilter, str):
        raise TypeError(f"rfilter must be a reconstruction filter or the name of one ({', '.join(sorted(filters))}), got "
                        f"{rfilter!r:.60}")
    if rfilter not in filters:
        raise ValueError(f"rfilter {rfilter!r} is not known; {nearest(rfilter, filters)}")
    return filters[rfilter]()


def array(name: str, value: Any, shape: tuple[int, ...] | None) -> np.ndarray:
    """Converts `value` to float64 numbers, checked.

    Raises:
        ValueError: if they are of another shape, not finite, or require a gradient.
    """
    if isinstance(value, Tensor):
        if value.requires_grad:
            raise no_gradient(name)
        value = value.detach().cpu()
    try:
        numbers = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"{name} must be numbers, got {value!r}") from None
    if shape is not None and numbers.shape != shape:
        raise ValueError(f"{name} must have shape {shape}, got {numbers.shape}")
    if not np.isfinite(numbers).all():
        raise ValueError(f"{name} must be finite, got {numbers.tolist()}")
    return numbers
