"""Where on the film a sample lies."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.film.filter import TABLE_SIZE, FilterPart, FilterTable
from torch_radbp.vec import Vec2, gather


class FilmTensors(NamedTuple):
    """What decides the places of samples; scalars are () tensors."""

    size_x: Tensor  # of the whole image, pixels
    size_y: Tensor
    crop_x: Tensor  # left edge of the crop window, pixels
    crop_y: Tensor
    filter: FilterTable
    part_x: FilterPart  # (W,) each: what a column of pixels samples of it
    part_y: FilterPart  # (H,) each

    def position(self, column: Tensor, row: Tensor, u: Tensor, v: Tensor) -> Vec2:
        """Places near the centres of pixels, offset by the reconstruction filter: fractions of the whole image, (N,).

        Args:
            column, row: (N,) of pixels inside the crop window.
            u, v: (N,) uniform numbers.
        """
        u, v = within(self.part_x, column, u), within(self.part_y, row, v)
        return Vec2((column + self.crop_x + 0.5 + quantile(self.filter.quantiles, u)) / self.size_x,
                    (row + self.crop_y + 0.5 + quantile(self.filter.quantiles, v)) / self.size_y)


    def weight(self, column: Tensor, row: Tensor, u: Tensor, v: Tensor) -> Tensor | None:
        """What the samples at these places count in their pixels, (N,); None: all the same, 1. Args as for `position`."""
        signs = self.filter.signs
        if signs is None:
            return None
        counts_x, counts_y = (gather(signs, between(within(part, index, number))) * gather(part.weight, index)
                              for part, index, number in ((self.part_x, column, u), (self.part_y, row, v)))
        return counts_x * counts_y


def within(part: FilterPart, index: Tensor, u: Tensor) -> Tensor:
    """Uniform numbers `u` in the part of a filter that the columns (or rows) `index` sample."""
    return gather(part.start, index) + u * gather(part.length, index)


def between(u: Tensor) -> Tensor:
    """The entry of a filter's table before `u` in [0, 1], int32."""
    return (u * (TABLE_SIZE - 1)).to(torch.int32).clamp_max(TABLE_SIZE - 2)


def quantile(table: Tensor, u: Tensor) -> Tensor:
    """Linear interpolation of a filter's (TABLE_SIZE,) table at `u` in [0, 1]."""
    left = between(u)
    fraction = u * (TABLE_SIZE - 1) - left
    return gather(table, left) * (1.0 - fraction) + gather(table, left + 1) * fraction
