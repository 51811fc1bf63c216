"""Tessellated spheres, which need no tree of triangles to be cast.

A ball is what an affine map makes of the unit sphere's tessellation into `RINGS` x `SEGMENTS` cells. All corners of a cell
are in one plane, so that the ball is a convex polyhedron with a facet for each cell, of two triangles but at the poles.
"""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor

SEGMENTS, RINGS = 192, 96
TRIANGLES = 2 * SEGMENTS * (RINGS - 1)


class Ball(NamedTuple):
    """A surface that is one, or one for each of its instances."""

    placement: Tensor  # (B, 4, 4) from the unit sphere to the world
    turned: tuple[bool, ...]  # of each: the second and third corner of every triangle are exchanged


class Balls(NamedTuple):
    """The balls among the triangles of a mesh, detached: `TRIANGLES` consecutive ones each.

    First of each cell, row by row from polar angle 0, the half that has its edge of lesser polar angle, but for the first
    row; then the others, but for the last row. The diagonal between the halves runs from the cell's corner of least azimuth
    and polar angle, which is the first of both, to the opposite one: third corner of the ones, second of the others.
    """

    first: Tensor  # (B,) int32, triangle
    turned: Tensor  # (B,) bool: the second and third corner of every triangle are exchanged
    placement: Tensor  # (B, 4, 4) from the unit sphere to the world; affine
