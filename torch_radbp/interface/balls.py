"""Tessellated spheres ("balls"), which rays can be cast against without a tree of triangles.

A ball is what an affine map makes of the unit sphere's tessellation into `RINGS` x `SEGMENTS` cells. All corners of a cell
are in one plane, so that the ball is a convex polyhedron with a facet for each cell, of two triangles but at the poles.
"""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor

SEGMENTS, RINGS = 192, 96
TRIANGLES = 2 * SEGMENTS * (RINGS - 1)


class Ball(NamedTuple):
    """The placement of a surface that is a tessellated sphere, or of each of its instances."""

    placement: Tensor  # (B, 4, 4) from the unit sphere to the world
    turned: tuple[bool, ...]  # of each: triangles are inside out, second and third corner exchanged


class Balls(NamedTuple):
    """The tessellated spheres in a mesh, detached: `TRIANGLES` consecutive triangles each.

    The cells between circles of latitude are halved into triangles. First come, row by row from polar angle 0, the halves at
    the lesser polar angle (but in the first row), then the others (but in the last). The diagonal runs from the cell's
    corner of least azimuth and polar angle, first corner of both halves, to the opposite one: third corner of the first
    halves, second of the others.
    """

    first: Tensor  # (B,) int32, first triangle
    turned: Tensor  # (B,) bool: triangles are inside out, second and third corner exchanged
    placement: Tensor  # (B, 4, 4) from the unit sphere to the world; affine
