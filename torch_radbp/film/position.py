"""Where samples lie on the film, and the pixels in which a point of it counts."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.film.filter import Kernel
from torch_radbp.vec import Vec2


class FilmTensors(NamedTuple):
    """The size of an image, the window of it that is rendered, and what samples count in pixels; scalars are () tensors."""

    size_x: Tensor  # of the whole image, pixels
    size_y: Tensor
    crop_x: Tensor  # left edge of the crop window, pixels
    crop_y: Tensor
    kernel: Kernel
    border: int  # pixels around the window in which there are samples, too
    inside_x: Tensor  # (W,) for each column of pixels: the integral of the filter over where there are samples
    inside_y: Tensor  # (H,) for each row

    def position(self, column: Tensor, row: Tensor, place: Vec2) -> Vec2:
        """Points inside of pixels as fractions of the whole image, (N,).

        Args:
            column, row: (N,) of pixels, counted from the upper left one that has samples.
            place: (N,) in them, in [0, 1).
        """
        return Vec2((column - self.border + self.crop_x + place.x) / self.size_x,
                    (row - self.border + self.crop_y + place.y) / self.size_y)

    def around(self, place: Vec2) -> tuple[Tensor, Tensor]:
        """The pixels in which points of the film count, and how much: the filter over its integral where there are samples.

        Args:
            place: (N,) points, pixels from the upper left corner of the crop window; float64.

        Returns:
            (N, P) row-major numbers of pixels of the window, int64, and what a point counts there, 0 where it does not.
        """
        (column, across), (row, down) = (counted(self.kernel, inside.double(), self.border, own)
                                         for inside, own in ((self.inside_x, place.x), (self.inside_y, place.y)))
        pixel = row[:, :, None] * len(self.inside_x) + column[:, None, :]
        return pixel.flatten(1), (down[:, :, None] * across[:, None, :]).flatten(1)


def counted(kernel: Kernel, inside: Tensor, border: int, place: Tensor) -> tuple[Tensor, Tensor]:
    """The columns (or rows) of pixels in which points count, and how much, (N, 2 reach + 1).

    Args:
        kernel: the filter.
        inside: (W,) its integral for each column.
        border: pixels around the window in which there are samples.
        place: (N,) pixels from the border of the window.
    """
    index = torch.floor(place)[:, None] + torch.arange(-kernel.reach, kernel.reach + 1, device=place.device)
    column = index.long().clamp(0, len(inside) - 1)
    sampled = (place >= -border) & (place < len(inside) + border)
    counts = torch.where((index == column) & sampled[:, None], kernel(place[:, None] - 0.5 - index), 0.0)
    return column, counts / inside[column]
