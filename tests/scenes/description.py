"""The words in which tests describe scenes: colours, cameras, rectangles; and how they are loaded."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

import torch_radbp as rb
from torch_radbp.io.values.transform import rotate, scale, translate


def look_at(origin, target, up) -> np.ndarray:
    """`rb.look_at` in float64, (4, 4)."""
    return rb.look_at(*(torch.tensor(value, dtype=torch.float64) for value in (origin, target, up))).numpy()


def rgb(*value: float) -> dict[str, Any]:
    return {"type": "rgb", "value": list(value)}


def diffuse(*value: float) -> dict[str, Any]:
    return {"type": "diffuse", "reflectance": rgb(*value)}


def texels(height: int, width: int, seed: int = 0) -> np.ndarray:
    """(height, width, 3) values in [0.1, 0.9], without any symmetry."""
    return np.random.default_rng(seed).uniform(0.1, 0.9, (height, width, 3))


SKY = {"type": "constant", "radiance": rgb(0.6, 0.9, 1.4)}
GLOW = {"type": "area", "radiance": rgb(1, 1, 1)}


def sensor(size: int = 8, origin=(0, 0, 3.5), target=(0, 0, 0), fov: float = 40, rfilter: str = "box",
           **attributes: Any) -> dict[str, Any]:
    """A perspective sensor, square unless `film=` says otherwise."""
    pose = look_at(origin, target, (0, 1, 0))
    return {"type": "perspective", "fov": fov, "to_world": pose, "film": square_film(size, rfilter)} | attributes


def overhead(size: int = 8, height: float = 4.0, half: float = 1.0, rfilter: str = "box") -> dict[str, Any]:
    """A view without perspective of x and y from -half to half, x to the right, from z = height."""
    pose = look_at((0, 0, height), (0, 0, 0), (0, 1, 0)) @ scale((half, half, 1))
    return {"type": "orthographic", "to_world": pose, "film": square_film(size, rfilter)}


def square_film(size: int, rfilter: str = "box") -> dict[str, Any]:
    return {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": rfilter}}


def load(dtype: torch.dtype = torch.float64, **objects: Any) -> rb.Scene:
    """The scene of these objects in `dtype`."""
    return rb.load_dict({"type": "scene", **objects}).to(dtype)


def rectangle(at, half: float | tuple = 1.0, axis=(1, 0, 0), angle: float = 0.0, **attributes: Any) -> dict[str, Any]:
    """A rectangle facing +z, scaled by `half`, turned by `angle` degrees about `axis`, moved to `at`."""
    factors = (half, half, half) if isinstance(half, (int, float)) else half
    return {"type": "rectangle", "to_world": translate(at) @ rotate(axis, angle) @ scale(factors)} | attributes


def parameters(scene: rb.Scene, names) -> list[Tensor]:
    """The parameters called `names`, which then require grad."""
    return [scene.get_parameter(name).requires_grad_() for name in names]
