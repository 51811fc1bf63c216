"""Positions of samples on the film, and their weights in the pixels around."""

from __future__ import annotations

import operator
from functools import reduce
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.film.filter import Kernel
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.vec import Vec2


class FilmTensors(NamedTuple):
    """A film as tensors: the image's size, the window that is rendered, and the filter; scalars are () tensors."""

    size_x: Tensor  # of the whole image, pixels
    size_y: Tensor
    crop_x: Tensor  # left edge of the window, pixels
    crop_y: Tensor
    origin: Vec2  # the left and the upper edge of where pixels are numbered from, pixels
    kernel: Kernel
    before: Vec2  # () int32, columns and rows of pixels before the window that have samples, too
    after: Vec2  # the same after it
    inside_x: Tensor  # (W,) each column's integral of the filter over where there are samples
    inside_y: Tensor  # (H,) for each row
    columns: Tensor  # () int32, W
    rows: Tensor  # () int32, H

    def position(self, column: Tensor, row: Tensor, place: Vec2) -> Vec2:
        """Positions in pixels as fractions of the whole image, (N,).

        Args:
            column, row: (N,) of pixels, counted from the upper left one of the film that has samples.
            place: (N,) in them, in [0, 1).
        """
        return Vec2((column + self.origin.x + place.x) / self.size_x, (row + self.origin.y + place.y) / self.size_y)

    def place(self, position: Vec2) -> Vec2:
        """Fractions of the whole image as pixels from the upper left corner of the window, (N,)."""
        return Vec2(position.x * self.size_x - self.crop_x, position.y * self.size_y - self.crop_y)

    def without_border(self) -> FilmTensors:
        """The film for points from everywhere, as of light paths: those beside the window count in it, too."""
        reach = torch.full_like(self.columns, self.kernel.reach)
        beside = Vec2(reach, reach)
        whole_x, whole_y = (torch.full_like(inside, self.kernel.integral, dtype=self.size_x.dtype)
                            for inside in (self.inside_x, self.inside_y))
        return self._replace(before=beside, after=beside, inside_x=whole_x, inside_y=whole_y)

    def around(self, place: Vec2) -> list[tuple[Tensor, Tensor]]:
        """The pixels to which points on the film contribute, with weights: the filter over its integral where samples lie.

        Args:
            place: (N,) points, pixels from the upper left corner of the window; float64.

        Returns:
            For each pixel around them its row-major number in the window, (N,) int32, and what a point counts there, (N,)
            float64, 0 where it does not.
        """
        columns, rows = self.columns_and_rows(place)
        return [(row * self.columns + column, down * across) for row, down in rows for column, across in columns]

    @property
    def margin(self) -> int:
        """The number of pixels beside the window to which points on a film `without_border` may contribute."""
        return 2 * self.kernel.reach

    def patch(self, place: Vec2) -> tuple[Tensor, list[Tensor], list[Tensor]]:
        """The pixels to which points contribute, of the window with a `margin` around it, on a film `without_border`: the
        row-major number of the upper left one, (N,) int32, and the factors of the weights of rows and of columns."""
        parts = ((self.columns, self.before.x, self.after.x, place.x), (self.rows, self.before.y, self.after.y, place.y))
        (column, across, in_columns), (row, down, in_rows) = (_weights(self.kernel, *part) for part in parts)
        number = (row + self.margin) * (self.columns + 2 * self.margin) + (column + self.margin)
        # Where samples lie everywhere the filter's integral is that of the first pixel.
        down, across = ([torch.where(sampled, value / lookup(inside, torch.zeros_like(number)), 0.0) for value in values]
                        for inside, values, sampled in ((self.inside_y, down, in_rows), (self.inside_x, across, in_columns)))
        return number, down, across

    def is_near(self, place: Vec2) -> Tensor:
        """(N,) bool: points lie in the window or so near to it that there are samples, as all do that contribute to it. Args
        as for `around`."""
        return (_is_sampled(self.columns, self.before.x, self.after.x, place.x)
                & _is_sampled(self.rows, self.before.y, self.after.y, place.y))

    def columns_and_rows(self, place: Vec2) -> tuple[list[tuple[Tensor, Tensor]], list[tuple[Tensor, Tensor]]]:
        """The columns and the rows of pixels to which points contribute, each with a factor of the weight; see `around`."""
        return (_counted(self.kernel, self.inside_x, self.columns, self.before.x, self.after.x, place.x),
                _counted(self.kernel, self.inside_y, self.rows, self.before.y, self.after.y, place.y))

    def sees(self, place: Vec2) -> Tensor:
        """(N,) bool: points on the film contribute to a pixel; args as for `around`."""
        columns, rows = self.columns_and_rows(place)
        return _any_counts(columns) & _any_counts(rows)


def _any_counts(pixels: list[tuple[Tensor, Tensor]]) -> Tensor:
    """(N,) bool: the weight of a point is not 0 in some pixel."""
    return reduce(operator.or_, [weight != 0.0 for _, weight in pixels])


def _is_sampled(size: Tensor, before: Tensor, after: Tensor, place: Tensor) -> Tensor:
    """(N,) bool: there are samples where points lie. Args as for `_counted`."""
    return (place + before >= 0) & (place < size + after)


def _weights(kernel: Kernel, size: Tensor, before: Tensor, after: Tensor,
             place: Tensor) -> tuple[Tensor, list[Tensor], Tensor]:
    """The columns (or rows) to which points contribute on an infinite film: the first one, (N,) int32, the filter's values
    from there on, and whether points lie where there are samples, (N,) bool. Args as for `_counted`."""
    nearest = torch.floor(place)
    sampled = _is_sampled(size, before, after, place)
    nearest = torch.where(sampled, nearest, 0.0)
    first, values = kernel.nearby(torch.where(sampled, place - nearest, 0.0))
    return nearest.to(torch.int32) + first, values, sampled


def _counted(kernel: Kernel, inside: Tensor, size: Tensor, before: Tensor, after: Tensor,
             place: Tensor) -> list[tuple[Tensor, Tensor]]:
    """The columns (or rows) to which points contribute, (N,) int32, and their weights; from the first to the last.

    Args:
        kernel: the filter.
        inside: (W,) its integral for each column.
        size: () int32, W.
        before, after: () int32, columns in front of the window and behind it in which there are samples, too.
        place: (N,) pixels from the border of the window.
    """
    first, values, sampled = _weights(kernel, size, before, after, place)
    counted = []
    for step, value in enumerate(values):
        index = first + step
        column = torch.minimum(index.clamp_min(0), size - 1)
        counted.append((column, torch.where((index == column) & sampled, value / lookup(inside, column), 0.0)))
    return counted
