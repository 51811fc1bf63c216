"""Casters, meshes and dtypes of the tests, and distances by other means."""

from __future__ import annotations

from importlib.util import find_spec

import pytest
import torch

from torch_radbp.tensors.vec import Vec3, cross, dot

WARP = pytest.param("warp", marks=pytest.mark.skipif(find_spec("warp") is None, reason="no module named 'warp'"))
CASTERS = ("embree", "direct", "brute", WARP)
COMPILED = ("embree", "direct", WARP)
MESHES = ("soup", "box", "sphere", "sphere in a box")
DTYPES = (torch.float32, torch.float64)


def crossing(vertices, faces, ray, prim):
    """t of the line with the plane of each lane's triangle, in float64: an independent account of the distance."""
    p0, p1, p2 = (Vec3.of(vertices.double()[faces[prim.long()].long()][:, corner]) for corner in range(3))
    o, d = (vector.map(torch.Tensor.double) for vector in ray)
    normal = cross(p1 - p0, p2 - p0)
    return dot(normal, p0 - o) / dot(normal, d)
