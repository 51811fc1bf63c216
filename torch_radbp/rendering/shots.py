"""The images that a call is to make: sensors, and windows of their images."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from torch import Tensor

from torch_radbp.call.view import Shot
from torch_radbp.plugin import Sensor, integer
from torch_radbp.rendering.cost import MOST_NUMBERED
from torch_radbp.rendering.settings import SensorChoice, sensor_indices
from torch_radbp.scene.modules.scene import Scene

Part = Sequence[int]  # x, y, width and height in the image that a call without a window gives, pixels
WindowChoice = Part | Sequence[Part] | None  # of all sensors, or of each; None: whole images


def shots_of(scene: Scene, sensors: SensorChoice, window: WindowChoice) -> list[Shot]:
    """The images to render, a `Shot` each, for the chosen sensors and windows.

    Raises:
        ValueError: if there is no such sensor, a window is none or lies outside of the image, or the sizes differ.
    """
    indices, available = sensor_indices(scene, sensors), scene.sensors
    seen = [available[index] for index in indices]
    parts = [None] * len(seen) if window is None else _parts_of(window, seen)
    shots = [Shot(sensor, index, sensor.film.window(part)) for sensor, index, part in zip(seen, indices, parts)]
    sizes = {(shot.window.columns.size, shot.window.rows.size) for shot in shots}
    if len(sizes) > 1:
        raise ValueError(f"the sensors of one call must have {'films' if window is None else 'windows'} of one size, got "
                         f"{sorted(sizes)}; render them in separate calls")
    return shots


def _parts_of(window: Part | Sequence[Part], sensors: Sequence[Sensor]) -> list[tuple[int, int, int, int]]:
    """The window (x, y, width, height) in the image of each sensor; errors as for `shots_of`."""
    given = window.tolist() if isinstance(window, (Tensor, np.ndarray)) else window
    if not isinstance(given, Sequence) or isinstance(given, str) or not len(given):
        raise ValueError(f"window must be (x, y, width, height), integers, or a list of one for each sensor, got {window!r}")
    one = all(np.ndim(part) == 0 for part in given)
    parts = [given] * len(sensors) if one else list(given)
    if len(parts) != len(sensors):
        raise ValueError(f"window must be one (x, y, width, height) for all sensors of the call, or a list of one for each "
                         f"of the {len(sensors)}, got {len(parts)}")
    return [checked_part(part, sensor) for part, sensor in zip(parts, sensors)]


def checked_part(part: Part, sensor: Sensor) -> tuple[int, int, int, int]:
    """Checks a window of a sensor's image, and converts it to integers."""
    part = part.tolist() if isinstance(part, (Tensor, np.ndarray)) else part
    if not isinstance(part, Sequence) or isinstance(part, str) or len(part) != 4:
        raise ValueError(f"window must be (x, y, width, height), four integers, got {part!r}")
    names = ("x", "y", "width", "height")
    x, y, width, height = (integer(f"{name} of window", value) for name, value in zip(names, part))
    film = sensor.film
    if min(x, y) < 0 or min(width, height) < 1 or x + width > film.crop_width or y + height > film.crop_height:
        raise ValueError(f"the window of {width} x {height} pixels at ({x}, {y}) must be at least 1 x 1 and lie inside the "
                         f"image of {film.crop_width} x {film.crop_height}")
    if film.crop_width * film.crop_height > MOST_NUMBERED:
        raise ValueError(f"a window must be of an image of at most {MOST_NUMBERED} pixels, which are numbered, got one of "
                         f"{film.crop_width} x {film.crop_height}; give the film a crop window")
    return x, y, width, height
