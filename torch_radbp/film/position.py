"""Where on the film a sample lies."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.film.filter import TABLE_SIZE
from torch_radbp.vec import Vec2, gather


class FilmTensors(NamedTuple):
    """What decides the places of samples; scalars are () tensors."""

    size_x: Tensor  # of the whole image, pixels
    size_y: Tensor
    crop_x: Tensor  # left edge of the crop window, pixels
    crop_y: Tensor
    quantiles: Tensor  # (TABLE_SIZE,) of the reconstruction filter
    inside_x: tuple[Tensor, Tensor]  # (W,) each: start and length of the part of the filter that a column samples
    inside_y: tuple[Tensor, Tensor]  # (H,) each

    def position(self, column: Tensor, row: Tensor, u: Tensor, v: Tensor) -> Vec2:
        """Places near the centres of pixels, offset by the reconstruction filter: fractions of the whole image, (N,).

        Args:
            column, row: (N,) of pixels inside the crop window.
            u, v: (N,) uniform numbers.
        """
        u = gather(self.inside_x[0], column) + u * gather(self.inside_x[1], column)
        v = gather(self.inside_y[0], row) + v * gather(self.inside_y[1], row)
        return Vec2((column + self.crop_x + 0.5 + quantile(self.quantiles, u)) / self.size_x,
                    (row + self.crop_y + 0.5 + quantile(self.quantiles, v)) / self.size_y)


    def weight(self, column: Tensor, row: Tensor, u: Tensor, v: Tensor) -> Tensor | None:
        """What the samples at these places count in their pixels, (N,); None: all the same, 1. Args as for `position`."""
        return None


def quantile(table: Tensor, u: Tensor) -> Tensor:
    """Linear interpolation of a filter's (TABLE_SIZE,) table at `u` in [0, 1]."""
    position = u * (TABLE_SIZE - 1)
    left = position.to(torch.int32).clamp_max(TABLE_SIZE - 2)
    fraction = position - left
    return gather(table, left) * (1.0 - fraction) + gather(table, left + 1) * fraction
