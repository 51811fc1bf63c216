"""Scenes with one emitter of each kind."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

import torch_radbp as rb
from tests.scenes import diffuse, load, look_at, rectangle, rgb, sensor, texels
from torch_radbp.io.values.transform import rotate, scale, translate

FLOOR = {"floor": rectangle((0, -0.6, 0), 1.3, angle=-90, bsdf=diffuse(0.5, 0.6, 0.7))}


def sky_image(height: int = 6, width: int = 9, sun: float = 20.0) -> np.ndarray:
    """(height, width, 3) without symmetry: a bright texel, and a block of black ones."""
    image = texels(height, width, 3)
    image[height // 3, width // 2] = sun
    image[height // 2 :, 1 : 1 + width // 2] = 0
    return image


def slide(height: int = 4, width: int = 5, seed: int = 9) -> dict[str, Any]:
    return {"type": "bitmap", "data": texels(height, width, seed), "raw": True}


def turned(*angles: float) -> np.ndarray:
    """A rotation about x, y and z, in degrees."""
    x, y, z = angles
    return rotate((0, 0, 1), z) @ rotate((0, 1, 0), y) @ rotate((1, 0, 0), x)


LAMP_POSE = translate((0.3, 1.1, -0.2)) @ rotate((1, 0, 0), 100) @ rotate((0, 0, 1), 20) @ scale((0.5, 0.3, 1))
SQUARE = {"type": "mesh", "vertex_positions": [[-0.4, 0.9, 0.3], [0.5, 1.2, 0.2], [0.4, 1.1, -0.5], [-0.5, 1.0, -0.4]],
          "faces": [[0, 2, 1], [0, 3, 2]], "vertex_texcoords": [[0.1, 0.2], [0.9, 0.1], [0.8, 0.7], [0.2, 0.9]]}

EMITTERS: dict[str, dict[str, Any]] = {
    "area": {"lamp": {"type": "rectangle", "to_world": LAMP_POSE, "emitter": {"type": "area", "radiance": slide()}}},
    "area_sphere": {"lamp": {"type": "sphere", "to_world": translate((0.2, 0.8, 0.1)) @ scale((0.3, 0.3, 0.3)),
                             "emitter": {"type": "area", "radiance": rgb(3, 2, 1)}}},
    "directionalarea": {"lamp": {"type": "rectangle", "to_world": LAMP_POSE,
                                 "emitter": {"type": "directionalarea", "radiance": slide()}}},
    "constant": {"lamp": {"type": "constant", "radiance": rgb(0.3, 0.4, 0.6)}},
    "envmap": {"lamp": {"type": "envmap", "bitmap": sky_image(), "scale": 1.5, "to_world": turned(20, 50, -10)}},
    "envmap_compensated": {"lamp": {"type": "envmap", "bitmap": sky_image(), "mis_compensation": True}},
    "sunsky": {"lamp": {"type": "sunsky", "sun_direction": [0.3, 0.9, 0.4], "sky_scale": 0.05, "sun_scale": 0.02,
                        "sun_aperture": 40.0, "to_world": turned(-90, 10, 5)}},
    "point": {"lamp": {"type": "point", "position": [0.4, 1.2, 0.3], "intensity": rgb(3, 2, 1)}},
    "spot": {"lamp": {"type": "spot", "to_world": look_at((0.8, 1.4, 0.7), (0, -0.5, 0), (0, 1, 0.1)),
                      "intensity": rgb(5, 4, 3), "cutoff_angle": 40.0, "beam_width": 12.0}},
    "spot_image": {"lamp": {"type": "spot", "to_world": look_at((0.8, 1.4, 0.7), (0, -0.5, 0), (0, 1, 0.1)),
                            "intensity": rgb(5, 4, 3), "cutoff_angle": 40.0, "beam_width": 12.0,
                            "texture": slide(seed=8)}},
    "projector": {"lamp": {"type": "projector", "to_world": look_at((-0.7, 1.4, 0.9), (0, -0.5, 0), (0.1, 1, 0)),
                           "irradiance": slide(), "scale": 2.0, "fov": 70.0}},
    "directional": {"lamp": {"type": "directional", "direction": [0.3, -1.0, -0.4], "irradiance": rgb(0.8, 0.7, 0.4)}},
}
EMITTERS["all"] = {f"{name}_{key}": value for name in ("area", "envmap", "point", "spot_image", "projector", "directional")
                   for key, value in EMITTERS[name].items()}
# Those that one can hit.
FINDABLE = ("area", "area_sphere", "constant", "envmap", "envmap_compensated", "sunsky")


def scene_of(name: str, dtype: torch.dtype = torch.float64, size: int = 8, **more: Any) -> rb.Scene:
    """A floor under one of `EMITTERS`, which a camera in front sees."""
    return load(dtype, sensor=sensor(size, (0, 0.5, 3.5), (0, 0, 0), 45), **FLOOR, **EMITTERS[name], **more)


