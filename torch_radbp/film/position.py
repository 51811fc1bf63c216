"""Where on the film a sample lies."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.film.filter import TABLE_SIZE, FilterPart, FilterTable
from torch_radbp.sampling.running_sum import running_sum
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

    def receiver(self, place: Vec2, u: Tensor, v: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """The pixels in which points of the film count, one for each, picked at random by the reconstruction filter.

        Args:
            place: (N,) points, pixels from the upper left corner of the crop window; float64.
            u, v: (N,) uniform numbers.

        Returns:
            Column and row in the crop window, int64, and what a point counts there over the probability of the pick.
        """
        parts = self.filter, self.part_x, self.part_y
        table, part_x, part_y = (type(part)(*(None if values is None else values.double() for values in part))
                                 for part in parts)
        column, counts_x = receiver(table, part_x, place.x, u)
        row, counts_y = receiver(table, part_y, place.y, v)
        return column, row, counts_x * counts_y

    def weight(self, column: Tensor, row: Tensor, u: Tensor, v: Tensor) -> Tensor | None:
        """What the samples at these places count in their pixels, (N,); None: all the same, 1. Args as for `position`."""
        signs = self.filter.signs
        if signs is None:
            return None
        counts_x, counts_y = (gather(signs, between(within(part, index, number))) * gather(part.weight, index)
                              for part, index, number in ((self.part_x, column, u), (self.part_y, row, v)))
        return counts_x * counts_y


def receiver(filter: FilterTable, part: FilterPart, place: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
    """The column (or row) of pixels that a point of the film counts in, picked at random by the filter.

    Args:
        filter: reconstruction filter.
        part: what the columns of the window sample of it.
        place: (N,) pixels from the border of the window.
        u: (N,) uniform numbers.

    Returns:
        The index in the window, int64, and what the point counts there over the probability of picking it, per pixel of
        width; 0 where it counts in none.
    """
    reach = float(filter.quantiles.abs().max())
    first = torch.ceil(place - 0.5 - reach)
    index = first[:, None] + torch.arange(int(2.0 * reach) + 1, dtype=place.dtype, device=place.device)
    column = index.long().clamp(0, len(part.start) - 1)
    offset = place[:, None] - 0.5 - index
    sampled = filter.at(offset) - part.start[column]
    counts = (index == column) & (sampled >= 0) & (sampled <= part.length[column])
    value = filter.density(offset) * counts / part.length[column]
    value = value if part.weight is None else value * part.weight[column]
    total = running_sum(value.abs(), 1)
    picked = (total < u[:, None] * total[:, -1:]).sum(1, keepdim=True).clamp_max(index.shape[1] - 1)
    return column.gather(1, picked).squeeze(1), (value.gather(1, picked).sign() * total[:, -1:]).squeeze(1)


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
