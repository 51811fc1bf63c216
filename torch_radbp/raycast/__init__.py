"""Ray casting behind one protocol: detached queries (`Ray` -> `Hit`), chosen by name."""

from __future__ import annotations

import importlib

from torch import Tensor

from torch_radbp.raycast.ball import castable
from torch_radbp.raycast.protocol import Hit, Ray, RayCaster
from torch_radbp.shape.ball import TRIANGLES, Balls

__all__ = ["Hit", "Ray", "RayCaster", "make_caster"]

# Imported when asked for: each has dependencies that the others do not need.
CASTERS = {"embree": "Embree", "direct": "Direct", "brute": "Brute", "warp": "Warp"}
FEW_TRIANGLES = 100  # a path's rays, camera rays aside, test so many one by one faster than a tree finds the right ones
FEW_BALLS = 128  # likewise; of incoherent rays, 256 take half of the time that a tree of their triangles does


def make_caster(name: str | None, vertices: Tensor, faces: Tensor, balls: Balls | None = None) -> RayCaster:
    """Builds the ray caster called `name` over a triangle mesh.

    Args:
        name: "embree" (CPU), "direct" (CPU, small meshes), "warp" (CUDA; slow on the CPU) or "brute" (any device and dtype,
            tiny meshes); None picks the fastest by the vertices' device and the number of triangles.
        vertices: (V, 3) float32 or float64, finite.
        faces: (F, 3) int32, counted from 0.
        balls: which of the triangles are tessellated spheres, found faster; None: none are known.

    Raises:
        ValueError: unknown name, or a mesh that cannot be used.
        ModuleNotFoundError: what "warp" needs is not installed.
    """
    if balls is not None and (len(balls.first) > FEW_BALLS or not bool(castable(balls).all())):
        balls = None
    if name is None:
        others = len(faces) - (0 if balls is None else TRIANGLES * len(balls.first))
        on_cpu = "direct" if others <= FEW_TRIANGLES else "embree"
        name = on_cpu if vertices.device.type == "cpu" else "warp"
    if name not in CASTERS:
        raise ValueError(f"unknown ray caster {name!r}; known are {', '.join(map(repr, CASTERS))}")
    module = importlib.import_module(f"torch_radbp.raycast.{name}")
    return getattr(module, CASTERS[name])(vertices, faces, balls)
