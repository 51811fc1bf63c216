"""Directions as texture coordinates by latitude and longitude.

A direction d has local coordinates l = W d / |W d|, W the inverse of the linear part of `to_world`, and texture coordinates

    u = atan2(l_x, -l_z) / (2 pi),   v = atan2(sqrt(l_x^2 + l_z^2), l_y) / pi

of which u is periodic. A density q over local solid angle is q |det W| / |W d|^3 over world solid angle, so that a pose that
is not rigid (an optimiser's, on the way) still has the right density.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.tensors.vec import TINY, Frame, Vec2, Vec3, cross, dot

NEAR_POLE = 1e-12  # squared distance from the axis below which the longitude is undefined


class Around(NamedTuple):
    """The four texels around a point of an image, and its position between them; (N,)."""

    upper: tuple[Tensor, Tensor]  # int32 texels above left and above right
    lower: tuple[Tensor, Tensor]
    across: Tensor  # in [0, 1], attached
    down: Tensor

    def interpolated(self, read):
        """Bilinear interpolation of what `read` returns at the four texels."""
        upper, lower = (read(left) * (1.0 - self.across) + read(right) * self.across
                        for left, right in (self.upper, self.lower))
        return upper * (1.0 - self.down) + lower * self.down


def texels_around(uv: Vec2, rows: Tensor, columns: Tensor) -> Around:
    """The four texels around points of an image whose rows reach from pole to pole.

    Args:
        uv: (N,) texture coordinates, attached.
        rows, columns: () int32, of the image.
    """
    x = uv.x * columns - 0.5
    y = uv.y * (rows - 1)
    left, top = torch.floor(x.detach()), torch.floor(y.detach())
    column, row = left.to(torch.int32), top.to(torch.int32)
    # Row and column of what is NaN are arbitrary integers, and must not lead out of the image.
    x0 = torch.minimum(torch.where(column < 0, columns - 1, column), columns - 1)  # u is in [0, 1]: no more than one before
    x1 = torch.where(x0 + 1 < columns, x0 + 1, 0)
    row, last = row.clamp_min(0), rows - 1
    y0, y1 = torch.minimum(row, last) * columns, torch.minimum(row + 1, last) * columns
    return Around((y0 + x0, y0 + x1), (y1 + x0, y1 + x1), x - left, y - top)


def local_direction(to_local: Frame, d: Vec3) -> tuple[Vec3, Tensor]:
    """Unit directions in local coordinates, and their solid angle per solid angle in the world.

    Args:
        to_local: (N,) rows of the matrix from world directions to local ones.
        d: (N,) unit directions.
    """
    local = to_local.to_local(d)
    shrink = torch.rsqrt(dot(local, local).clamp_min(TINY))
    return local * shrink, determinant(to_local) * shrink * shrink * shrink


def determinant(rows: Frame) -> Tensor:
    """The absolute value of the determinant of the matrix with these rows."""
    return dot(rows.s, cross(rows.t, rows.n)).abs()


def latitude_longitude(local: Vec3) -> Vec2:
    """Texture coordinates of unit directions: u in [0, 1), periodic; v in [0, 1], 0 at +y. Finite at the poles."""
    squared = local.x * local.x + local.z * local.z
    away = squared.detach() > NEAR_POLE
    x, z = torch.where(away, local.x, 0.0), torch.where(away, local.z, -1.0)
    u = torch.atan2(x, -z) * (0.5 / math.pi)
    v = torch.atan2(torch.sqrt(squared.clamp_min(NEAR_POLE)), local.y) * (1.0 / math.pi)
    return Vec2(u - torch.floor(u.detach()), v)
