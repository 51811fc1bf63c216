"""Writes the lights and cameras of a scene as those of glTF; see `lamp` for units and axes."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from torch import Tensor

from torch_radbp.io.gltf.document import Losses
from torch_radbp.plugin import Emitter, Sensor, Texture
from torch_radbp.sensor.calibrated import Calibrated

HALF_TURN = np.diag([-1.0, 1.0, -1.0, 1.0])  # about y: from what looks along +z to what looks along -z
SQUARE = 1e-5  # how far the sides of pixels may differ
CENTRED = 1e-6  # of the size of an image, that its principal point may be off the middle


def matrix_of(pose: Tensor) -> np.ndarray:
    """A pose as a (4, 4) float64 array."""
    return pose.detach().cpu().double().numpy()


def column_major(matrix: np.ndarray) -> dict[str, list[float]]:
    """The entry `matrix` of a node; none for the identity."""
    return {} if np.array_equal(matrix, np.eye(4)) else {"matrix": matrix.T.reshape(-1).tolist()}


def _rigid(pose: np.ndarray) -> np.ndarray:
    """The node transform, without scale, of an object that looks along +z of a pose."""
    ahead, up = pose[:3, 2] / np.linalg.norm(pose[:3, 2]), pose[:3, 1]
    left = np.cross(up, ahead)
    left /= np.linalg.norm(left)
    matrix = np.eye(4)
    matrix[:3] = np.stack([left, np.cross(ahead, left), ahead, pose[:3, 3]], axis=1)
    return matrix @ HALF_TURN


def _brightness(colour: Texture) -> dict[str, Any]:
    """The entries for a light's colour and intensity."""
    values = colour.texels().detach().cpu().double().reshape(3).numpy()
    intensity = float(values.max())
    return {"color": (values / intensity if intensity > 0 else np.ones(3)).tolist(), "intensity": intensity}


def point(emitter: Emitter, name: str, losses: Losses) -> tuple[dict[str, Any], np.ndarray]:
    place = np.eye(4)
    place[:3, 3] = emitter.position.detach().cpu().double().numpy()
    return {"type": "point", **_brightness(emitter.intensity)}, place


def directional(emitter: Emitter, name: str, losses: Losses) -> tuple[dict[str, Any], np.ndarray]:
    return {"type": "directional", **_brightness(emitter.irradiance)}, _rigid(matrix_of(emitter.to_world))


def spot(emitter: Emitter, name: str, losses: Losses) -> tuple[dict[str, Any], np.ndarray]:
    if emitter.texture is not None:
        losses.add(name, "the texture of a spot is not written")
    if float(emitter.cutoff_angle) > 90:
        losses.add(name, "the cutoff_angle of a spot is written as 90 degrees, the widest that glTF has")
    outer = min(math.radians(float(emitter.cutoff_angle)), math.pi / 2)
    cone = {"innerConeAngle": min(math.radians(float(emitter.beam_width)), 0.999 * outer), "outerConeAngle": outer}
    return {"type": "spot", **_brightness(emitter.intensity), "spot": cone}, _rigid(matrix_of(emitter.to_world))


Light = Callable[[Emitter, str, Losses], tuple[dict[str, Any], np.ndarray]]
LIGHTS: dict[str, Light] = {"point": point, "directional": directional, "spot": spot}


def light_of_emitter(emitter: Emitter, name: str, losses: Losses) -> tuple[dict[str, Any], np.ndarray] | None:
    """Converts an emitter to a light of KHR_lights_punctual and its node's transform; None if glTF has no such kind."""
    if emitter.type not in LIGHTS:
        losses.add(name, f"a {emitter.type} emitter has no counterpart in glTF, and is not written; those that have one: "
                         f"area, {', '.join(sorted(LIGHTS))}")
        return None
    return LIGHTS[emitter.type](emitter, name, losses)


def _unknown(sensor: Sensor, name: str, losses: Losses) -> None:
    """Notes that glTF has no camera of this sensor's kind."""
    losses.add(name, f"a {sensor.type} sensor has no counterpart in glTF, and is not written; those that have one: "
                     "orthographic, perspective")


def camera_of_sensor(sensor: Sensor, name: str, losses: Losses) -> tuple[dict[str, Any], np.ndarray] | None:
    """Converts a sensor to a camera and its node's transform; None if glTF has no such kind."""
    if not (hasattr(sensor, "film") and hasattr(sensor, "to_world")):
        return _unknown(sensor, name, losses)
    if isinstance(sensor, Calibrated) and not sensor.is_fisheye:
        if beyond := sensor.beyond_perspective():
            losses.add(name, f"its {', '.join(beyond)} is not written: cameras of glTF are pinholes with square pixels")
        sensor = sensor.as_perspective()
    film, aspect = sensor.film, sensor.film.width / sensor.film.height
    if (film.crop_width, film.crop_height) != (film.width, film.height):
        losses.add(name, "its crop window is not written")
    size = {"extras": {"width": film.width, "height": film.height}}
    pose = matrix_of(sensor.to_world)
    if hasattr(sensor, "x_fov"):
        if sensor.type != "perspective":
            losses.add(name, f"a {sensor.type} camera is written as a perspective one")
        if any(abs(float(getattr(sensor, f"principal_point_offset_{axis}", 0.0))) > CENTRED for axis in "xy"):
            losses.add(name, "its principal point is written as the middle of the image")
        lens = {"aspectRatio": aspect, "yfov": 2 * math.atan(math.tan(math.radians(float(sensor.x_fov)) / 2) / aspect),
                "znear": sensor.near_clip, "zfar": sensor.far_clip}
        return {"type": "perspective", "perspective": lens, **size}, _rigid(pose)
    if sensor.type != "orthographic":
        return _unknown(sensor, name, losses)
    across, up, ahead = np.linalg.norm(pose[:3, :3], axis=0)
    if abs(across - up) > SQUARE * across:
        losses.add(name, "its pixels are not square, and come back as squares")
    near = sensor.near_clip * ahead
    lens = {"xmag": across, "ymag": up / aspect, "znear": near, "zfar": near + sensor.far_clip - sensor.near_clip}
    return {"type": "orthographic", "orthographic": {key: float(value) for key, value in lens.items()}, **size}, _rigid(pose)
