"""Ray casting behind one protocol: detached queries (`Ray` -> `Hit`), chosen by name."""

from __future__ import annotations

import importlib
from functools import partial

from torch import Tensor

from torch_radbp.interface.balls import TRIANGLES, Balls
from torch_radbp.interface.instances import Instances
from torch_radbp.raycast.ball import castable
from torch_radbp.raycast.expanded import ExpandedCaster
from torch_radbp.raycast.mesh import MeshExtremes
from torch_radbp.raycast.protocol import Hit, Ray, RayCaster
from torch_radbp.raycast.runs import MOST_TRIANGLES

__all__ = ["Hit", "Ray", "RayCaster", "make_caster"]

# Imported when asked for: each has dependencies that the others do not need.
CASTERS = {"embree": "Embree", "direct": "DirectCaster", "brute": "Brute", "warp": "Warp"}
# What a path's rays cost at most, in tests of a triangle, to be cast faster without a tree: scattered boxes are three to
# eight times as fast, even a thousand triangles of them; scattered triangles, whose runs are not compact, begin to lose.
FEW_TESTS = 230
FEW_BALLS = 128  # likewise; of incoherent rays, 256 take half of the time that a tree of their triangles does

# Triangles that instances show, each counted, up to which Warp has copies of them in one tree, at 174 bytes each. Scattered
# things are found by fewer boxes in two levels, such that pierce each other by more (`python -m benchmarks.trees`).
MOST_COPIED = 1 << 18


def make_caster(name: str | None, vertices: Tensor, faces: Tensor, balls: Balls | None = None,
                instances: Instances | None = None, last: RayCaster | None = None,
                known: MeshExtremes | None = None) -> RayCaster:
    """Builds the ray caster called `name` over a triangle mesh.

    Args:
        name: "embree" (CPU), "direct" (CPU, small meshes), "warp" (CUDA; slow on the CPU) or "brute" (any device and dtype,
            tiny meshes); None picks the fastest by the vertices' device and the number of triangles.
        vertices: (V, 3) float32 or float64, finite.
        faces: (F, 3) int32, counted from 0.
        balls: which of the triangles are tessellated spheres, found faster; None: none are known.
        instances: of groups, whose triangles come last and are seen only there; None: there are none. The triangles of a
            group are kept once by "embree", and by "warp" where copies were many.
        last: a caster whose trees of groups the new one may take over; None: none.
        known: the extremes of the mesh, if its device has been asked for them already.

    Raises:
        ValueError: unknown name, or a mesh that cannot be used.
        ModuleNotFoundError: what "warp" needs is not installed.
    """
    if balls is not None and (len(balls.first) > FEW_BALLS or not bool(castable(balls).all())):
        balls = None
    if name is None and vertices.device.type == "cpu":
        if few(faces, balls, instances):
            direct = _new_caster("direct", vertices, faces, balls, instances)
            if (direct if instances is None else direct.caster).cost <= FEW_TESTS:
                return direct
        name = "embree"
    return _new_caster(name or "warp", vertices, faces, balls, instances, last, known)


def _new_caster(name: str, vertices: Tensor, faces: Tensor, balls: Balls | None, instances: Instances | None,
                last: RayCaster | None = None, known: MeshExtremes | None = None) -> RayCaster:
    """Builds the ray caster called `name`, as `make_caster` does; instances are copied for casters that know none."""
    if name not in CASTERS:
        raise ValueError(f"unknown ray caster {name!r}; known are {', '.join(map(repr, CASTERS))}")
    caster = getattr(importlib.import_module(f"torch_radbp.raycast.{name}"), CASTERS[name])
    if instances is None:
        return caster(vertices, faces, balls, known) if name == "warp" else caster(vertices, faces, balls)
    last = last if isinstance(last, caster) else None
    if name == "embree":
        return caster(vertices, faces, balls, instances, last)
    if name == "warp" and instances.shown_triangles() > MOST_COPIED:
        return caster(vertices, faces, balls, known, instances, last)
    return ExpandedCaster(partial(caster, balls=balls), vertices, faces, instances)


def few(faces: Tensor, balls: Balls | None, instances: Instances | None) -> bool:
    """True if a mesh has so few triangles that casting without a tree may be cheaper. Args: as for `make_caster`."""
    seen = len(faces) if instances is None else instances.triangles()
    return seen - (0 if balls is None else TRIANGLES * len(balls.first)) <= MOST_TRIANGLES
