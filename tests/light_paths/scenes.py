"""A ball over a floor under each kind of lamp."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

import torch_radbp as rb
from tests.scenes import diffuse, load, look_at, rectangle, rgb, sensor, texels

TOWARDS = look_at((1, 1, 3), (0, 0, 0), (0, 1, 0))
LAMPS: dict[str, dict[str, Any]] = {
    "point": {"type": "point", "position": [1.0, 1.0, 3.0], "intensity": rgb(10, 12, 14)},
    "spot": {"type": "spot", "to_world": TOWARDS, "cutoff_angle": 35, "intensity": rgb(10, 12, 14)},
    "projector": {"type": "projector", "to_world": TOWARDS, "fov": 40,
                  "irradiance": {"type": "bitmap", "data": texels(4, 4), "raw": True}},
    "directional": {"type": "directional", "direction": [-0.3, -0.2, -1.0], "irradiance": rgb(2, 3, 4)},
    "area": rectangle((0, 0, 3), 0.7, (1, 0, 0), 180, emitter={"type": "area", "radiance": {
        "type": "bitmap", "data": texels(3, 3), "raw": True}}),
    "directionalarea": rectangle((0, 0, 3), 0.8, (1, 0, 0), 180, emitter={"type": "directionalarea", "radiance": 1.5}),
    "constant": {"type": "constant", "radiance": rgb(0.7, 0.8, 0.9)},
    "envmap": {"type": "envmap", "bitmap": texels(4, 8)},
}
CAMERAS: dict[str, dict[str, Any]] = {
    "perspective": {"principal_point_offset_x": 0.05},
    "thinlens": {"type": "thinlens", "aperture_radius": 0.2, "focus_distance": 4.0},
    "orthographic": {"type": "orthographic"},
}
BALL = {"type": "sphere", "center": [0.3, 0, 0.6], "radius": 0.6}


def camera_named(name: str, size: int = 8, rfilter: str = "box") -> dict[str, Any]:
    """A camera of a kind that looks down at the ball."""
    plain = sensor(size, (0, -2.5, 4), (0, 0, 0), 50, rfilter)
    if name == "orthographic":
        scale = np.diag([2.0, 2.0, 1.0, 1.0])
        plain = {key: value for key, value in plain.items() if key != "fov"} | {"to_world": plain["to_world"] @ scale}
    return plain | CAMERAS[name]


def lit_ball(lamp: str, camera: str = "perspective", dtype: torch.dtype = torch.float32, size: int = 8, rfilter: str = "box",
             integrator: str = "path", **ball: Any) -> rb.Scene:
    """A ball over a floor, by default both diffuse."""
    return load(dtype, integrator={"type": integrator, "max_depth": 4}, camera=camera_named(camera, size, rfilter),
                floor=rectangle((0, 0, 0), 3.0, bsdf=diffuse(0.6, 0.5, 0.4)), lamp=LAMPS[lamp],
                ball=BALL | {"bsdf": diffuse(0.7, 0.6, 0.8)} | ball)
