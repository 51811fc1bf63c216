"""Develops images from the filter-weighted sums of samples."""

from __future__ import annotations

import operator
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.film.filter import Kernel
from torch_radbp.film.splat import PIECE, PIECE_ELSEWHERE, TOGETHER, Block, offset_sums
from torch_radbp.film.window import Window
from torch_radbp.tensors.differentiated import linear
from torch_radbp.tensors.stage import Stage
from torch_radbp.tensors.vec import Vec2


class Grid(NamedTuple):
    """The pixel grid of a film: the window that is rendered, and the pixels beside it whose samples count there."""

    kernel: Kernel
    window: Window

    @property
    def columns(self) -> int:
        return self.window.columns.sampled

    @property
    def rows(self) -> int:
        return self.window.rows.sampled

    def cropped(self, image: Tensor, around: int = 0) -> Tensor:
        """Crops (..., rows, columns) to the window and `around` more pixels on each side, (..., H, W)."""
        columns, rows = ((around + span.before, around + span.before + span.size) for span in self.window[:2])
        return image[..., slice(*rows), slice(*columns)]

    def quotient(self, image: Tensor, filters: Tensor) -> Tensor:
        """(C, ...) an image (C, H, W) divided by the sums of filter weights, padded with zeros up to the last sample."""
        reach = self.kernel.reach
        padded = image.new_zeros(len(image), self.rows + 2 * reach, self.columns + 2 * reach)
        inside = self.cropped(padded, reach)
        torch.div(image, torch.where(filters == 0, 1.0, filters), out=inside)
        return padded


def row_sums(stage: Stage, grid: Grid, values: tuple[Tensor, ...], block: Block) -> Tensor:
    """(R, 1 + C, n, columns): weighted sums of samples in n pixel rows, for each of the R rows in the filter's reach.

    Args:
        stage: `splat.deposited`, as it is run.
        values: C of the samples of all pixels of these rows, row by row.
        grid: of the film.
        block: of the samples.
    """
    (place, samples, spp), rows = block, len(block.place.x) // (block.samples * grid.columns)
    piece = PIECE if place.x.is_cpu else PIECE_ELSEWHERE
    most = max(1, piece * min(samples, TOGETHER) // (samples * grid.columns))
    pieces = []
    for first in range(0, rows, most):
        lanes = slice(first * grid.columns * samples, (first + most) * grid.columns * samples)
        part_of_block = Block(Vec2(*(part[lanes] for part in place)), samples, spp)
        pieces.append(across(grid, offset_sums(stage, grid.kernel, tuple(value[lanes] for value in values), part_of_block)))
    return torch.cat(pieces, 2)


def across(grid: Grid, sums: Tensor) -> Tensor:
    """Moves (R, R, 1 + C, n columns) sums by offset to the columns in which they count: (R, 1 + C, n, columns)."""
    reach, columns = grid.kernel.reach, grid.columns
    sums = sums.unflatten(-1, (-1, columns))
    total = torch.zeros_like(sums[:, 0])
    for offset in range(-reach, reach + 1):
        first, last = max(0, offset), min(columns, columns + offset)
        total[..., first:last] += sums[:, offset + reach, :, :, first - offset:last - offset]
    return total


class Development:
    """Accumulates the rows of an image, from above on, as their weighted sums arrive.

    However many rows come at once, every pixel is the same sum in the same order.
    """

    def __init__(self, grid: Grid):
        self.grid, self.done, self.received = grid, 0, 0
        self.waiting: Tensor | None = None  # (R, 1 + C, n, columns) of the last rows, which count in some to come
        self.total: Tensor | None = None  # (1 + C, rows, columns), of which `done` rows are done

    def add(self, sums: Tensor) -> None:
        """Adds the sums of the next pixel rows, which `row_sums` returns."""
        reach, rows = self.grid.kernel.reach, self.grid.rows
        if self.waiting is None:
            self.total = sums.new_zeros(sums.shape[1], rows, self.grid.columns)
        else:
            sums = torch.cat([self.waiting, sums], 2)
        start = self.received - (0 if self.waiting is None else self.waiting.shape[2])  # the row of its first
        self.received = start + sums.shape[2]
        last = rows if self.received == rows else max(self.done, self.received - reach)
        for offset in range(-reach, reach + 1):
            first, end = max(self.done, offset), min(last, rows + offset)
            if first < end:
                self.total[:, first:end] += sums[offset + reach][:, first - offset - start:end - offset - start]
        self.done = last
        self.waiting = sums[:, :, max(0, last - reach - start):].clone()  # a view would keep all of it

    def image(self) -> tuple[Tensor, Tensor]:
        """The image, (C, H, W), and the sums of filter weights, (H, W), by which it was divided."""
        total = self.grid.cropped(self.total)
        filters = total[0].detach()
        return linear(operator.truediv, total[1:], torch.where(filters == 0, 1.0, filters)), filters
