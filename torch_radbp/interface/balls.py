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
    """The tessellated sphere that a surface is, or one for each of its instances."""

    placement: Tensor  # (B, 4, 4) from the unit sphere to the world
    turned: tuple[bool, ...]  # of each: triangles are inside out, second and third corner exchanged


class Balls(NamedTuple):
    """The tessellated spheres in a mesh, detached: `TRIANGLES` consecutive triangles each.

    First of each cell, row by row from polar angle 0, the half that has its edge of lesser polar angle, but for the first
    row; then the others, but for the last row. The diagonal between the halves runs from the cell's corner of least azimuth
    and polar angle, which is the first of both, to the opposite one: third corner of the ones, second of the others.
    """

    first: Tensor  # (B,) int32, first triangle
    turned: Tensor  # (B,) bool: triangles are inside out, second and third corner exchanged
    placement: Tensor  # (B, 4, 4) from the unit sphere to the world; affine
