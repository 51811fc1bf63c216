"""Ray casting behind one protocol: detached queries (`Ray` -> `Hit`), chosen by name."""

from __future__ import annotations

import importlib
from functools import partial

import torch
from torch import Tensor

from torch_radbp.raycast.ball import castable, other_triangles
from torch_radbp.raycast.expanded import ExpandedCaster
from torch_radbp.raycast.mesh import checked_faces
from torch_radbp.raycast.protocol import Hit, Ray, RayCaster
from torch_radbp.shape.ball import TRIANGLES, Balls
from torch_radbp.shape.placement import Instances

__all__ = ["Hit", "Ray", "RayCaster", "make_caster"]

# Imported when asked for: each has dependencies that the others do not need.
CASTERS = {"embree": "Embree", "direct": "Direct", "brute": "Brute", "warp": "Warp"}
# What a path's rays test one by one faster than a tree finds the right triangles, in tests of a triangle: scattered boxes
# about 230, small lamps in a large room, which a tree hardly meets, 145. A corner costs less than a triangle.
FEW_TESTS, CORNER = 180, 0.6
FEW_BALLS = 128  # likewise; of incoherent rays, 256 take half of the time that a tree of their triangles does


def make_caster(name: str | None, vertices: Tensor, faces: Tensor, balls: Balls | None = None,
                instances: Instances | None = None, last: RayCaster | None = None) -> RayCaster:
    """Builds the ray caster called `name` over a triangle mesh.

    Args:
        name: "embree" (CPU), "direct" (CPU, small meshes), "warp" (CUDA; slow on the CPU) or "brute" (any device and dtype,
            tiny meshes); None picks the fastest by the vertices' device and the number of triangles.
        vertices: (V, 3) float32 or float64, finite.
        faces: (F, 3) int32, counted from 0.
        balls: which of the triangles are tessellated spheres, found faster; None: none are known.
        instances: of groups, whose triangles come last and are seen only there; None: there are none. Only "embree" keeps
            the triangles of a group once.
        last: a caster whose parts the new one may take over; None: none.

    Raises:
        ValueError: unknown name, or a mesh that cannot be used.
        ModuleNotFoundError: what "warp" needs is not installed.
    """
    if balls is not None and (len(balls.first) > FEW_BALLS or not bool(castable(balls).all())):
        balls = None
    if name is None:
        on_cpu = vertices.device.type == "cpu"
        name = "warp" if not on_cpu else "direct" if few(vertices, faces, balls, instances) else "embree"
    if name not in CASTERS:
        raise ValueError(f"unknown ray caster {name!r}; known are {', '.join(map(repr, CASTERS))}")
    caster = getattr(importlib.import_module(f"torch_radbp.raycast.{name}"), CASTERS[name])
    if instances is None:
        return caster(vertices, faces, balls)
    if name == "embree":
        return caster(vertices, faces, balls, instances, last if isinstance(last, caster) else None)
    return ExpandedCaster(partial(caster, balls=balls), vertices, faces, instances)


def few(vertices: Tensor, faces: Tensor, balls: Balls | None, instances: Instances | None) -> bool:
    """True if rays test all triangles but those of balls faster than a tree finds the right ones. Args: as `make_caster`."""
    seen = len(faces) if instances is None else instances.triangles()
    seen -= 0 if balls is None else TRIANGLES * len(balls.first)
    if seen > FEW_TESTS:
        return False
    others = checked_faces(faces if balls is None else other_triangles(faces, balls)[0], len(vertices), vertices.device)
    corners = len(torch.unique(vertices[others.long()].flatten(0, 1), dim=0))
    return seen * (1 + CORNER * corners / max(1, len(others))) <= FEW_TESTS
