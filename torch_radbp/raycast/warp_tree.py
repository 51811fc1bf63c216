"""Warp's tree of triangles, built of triangles that are a little larger than those that rays meet, see `warp.py`."""

from __future__ import annotations

import math

import torch
import warp as wp
from torch import Tensor

# Triangles in a leaf. 32 rays that wait for each other test the triangles of all leaves that one of them comes to at a time:
# by leaves of 1, where Warp has 4, a half to a third of the triangles, and a tenth to a fourth more boxes (`python -m
# benchmarks.trees`). On GPUs its trees take the same memory, but of three times as many nodes.
LEAF = 1
WIDER = 2.0**-20  # how much wider boxes are, in units of the mesh's extent: enough for rays from 8 extents away


def triangle_tree(corners: Tensor, stream: wp.Stream | None) -> wp.Mesh:
    """Builds Warp's tree over triangles.

    Args:
        corners: (F, 3, 3) float32, as by `in_units`.
        stream: on which it is built; None on the CPU.
    """
    points = widened(corners)
    numbers = torch.arange(len(points), dtype=torch.int32, device=points.device)
    with wp.ScopedStream(stream, sync_enter=False):
        tree = wp.Mesh(wp.from_torch(points, dtype=wp.vec3), wp.from_torch(numbers), bvh_leaf_size=LEAF)
    points.copy_(corners.flatten(0, 1))  # the tree stays as it is
    return tree


def lanes_of(column: Tensor):
    """Warp's array descriptor of a tensor, of any stride; the tensor must outlive the launch."""
    return wp.from_torch(column, return_ctype=True, requires_grad=False)


def power_of_2_units(extent: float) -> float:
    """The power of two, which rounds nothing, that scales a mesh of some extent to about unit extent."""
    exponent = math.frexp(extent)[1] if extent > 0 else 0
    return 2.0 ** max(-120, min(120, -exponent))


def in_units(corners: Tensor, unit: float | Tensor) -> Tensor:
    """The corners of triangles, (F, 3, 3), scaled; those without area become points, which rays surely miss."""
    corners = corners * unit
    first, second, third = corners.double().unbind(1)
    flat = (torch.linalg.cross(second - first, third - first) == 0).all(dim=1)
    return torch.where(flat[:, None, None], corners[:, :1], corners)


def widened(corners: Tensor) -> Tensor:
    """Moves the corners of triangles outwards so that their bounding boxes grow by `WIDER` on every side.

    Args:
        corners: (F, 3, 3).

    Returns:
        (3 F, 3)
    """
    least, most = corners.argmin(dim=1, keepdim=True), corners.argmax(dim=1, keepdim=True)
    most = torch.where(most == least, (least + 1) % 3, most)
    below, above = corners.gather(1, least), corners.gather(1, most)
    infinity = torch.full_like(below, torch.inf)
    # Far from the origin the numbers themselves are farther apart.
    below = torch.minimum(below - WIDER, torch.nextafter(below, -infinity))
    above = torch.maximum(above + WIDER, torch.nextafter(above, infinity))
    return corners.scatter(1, least, below).scatter(1, most, above).flatten(0, 1).contiguous()
