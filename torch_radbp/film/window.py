"""Windows: the part of an image that a call renders, and the pixels beside it whose samples count there, too."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor


class Span(NamedTuple):
    """A range of pixel columns (or rows), and the columns beside it that have samples, too."""

    first: int  # counted in the whole image
    size: int
    before: int  # columns with samples before the first
    after: int  # and after the last
    number: int  # index of the first column with samples, among all columns of the film that have any

    @staticmethod
    def within(crop: int, pixels: int, border: int, first: int, size: int, reach: int) -> Span:
        """The span of `size` columns from column `first` of a crop window on.

        As many beside them have samples as the filter reaches, but no more than where the whole crop window is rendered.

        Args:
            crop: the first column of the crop window.
            pixels: its columns.
            border: columns on either side of it that have samples.
            first, size: of the span.
            reach: of the filter, pixels.
        """
        before, after = min(reach, first + border), min(reach, pixels - first - size + border)
        return Span(crop + first, size, before, after, first + border - before)

    @property
    def sampled(self) -> int:
        """The number of columns that have samples."""
        return self.before + self.size + self.after


class Window(NamedTuple):
    """The rectangle of an image that is rendered."""

    columns: Span
    rows: Span
    numbered: int  # columns of the film that have samples, by which pixels are numbered

    def numbers(self, column: Tensor | int, row: Tensor | int) -> Tensor | int:
        """The numbers of pixels that index their random numbers: the same in every window of a film.

        Args:
            column, row: counted from the upper left pixel of the window that has samples; (N,) int32.
        """
        return (row + self.rows.number) * self.numbered + (column + self.columns.number)
