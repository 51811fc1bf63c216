"""A discrete distribution over the cells of a grid, sampled by two binary searches."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.sampling.running_sum import running_sum


class GridSample(NamedTuple):
    """A sampled cell of a grid per lane, and the position within it."""

    row: Tensor  # (N,) int64
    column: Tensor  # (N,) int64
    down: Tensor  # (N,) uniform in [0, 1]: rescaled from the number that picked the row
    across: Tensor  # (N,) likewise for the column


class GridDistribution(NamedTuple):
    """A distribution over R x C cells: a row is sampled first, then a cell of it. Float64 whatever the scene's dtype.

    One running sum over all cells, row by row, serves both searches.
    """

    rows: Tensor  # (R + 1,) sum of the weights of the rows above
    cells: Tensor  # (1 + R C,) sum of the weights of the cells before
    size: tuple[Tensor, Tensor]  # () int64 each, R and C

    def sample(self, u: Tensor, v: Tensor) -> GridSample:
        """Samples cells by uniform float64 numbers `u` (rows) and `v` (columns) in [0, 1), (N,)."""
        count, columns = self.size
        u = u * self.rows.index_select(0, torch.zeros_like(u, dtype=torch.int64) + count)
        row = torch.minimum(torch.searchsorted(self.rows, u.contiguous(), right=True) - 1, count - 1)
        above, below = self.rows.index_select(0, row), self.rows.index_select(0, row + 1)
        v = above + v * (below - above)
        first = row * columns
        cell = torch.searchsorted(self.cells, v, right=True) - 1
        cell = torch.minimum(torch.maximum(cell, first), first + columns - 1)  # where a row is so dark that v is rounded
        left, right = self.cells.index_select(0, cell), self.cells.index_select(0, cell + 1)
        return GridSample(row, cell - first, within(u, above, below), within(v, left, right))


def within(u: Tensor, low: Tensor, high: Tensor) -> Tensor:
    """The position of `u` between two bounds, from 0 to 1."""
    return ((u - low) / (high - low).clamp_min(1e-300)).clamp(0.0, 1.0)


def grid_distribution(weights: Tensor) -> GridDistribution:
    """The distribution proportional to weights (R, C), non-negative, not all zero; detached."""
    (rows, columns), cells = weights.shape, weights.new_empty(1 + weights.numel(), dtype=torch.float64)
    cells[0], cells[1:] = 0.0, weights.detach().flatten()
    running_sum(cells, out=cells)
    return GridDistribution(cells[::columns].contiguous(), cells,
                            (_length(rows, weights.device), _length(columns, weights.device)))


@lru_cache(maxsize=64)
def _length(count: int, device: torch.device) -> Tensor:
    """A number of rows or columns, () int64, on a device."""
    with torch.inference_mode(False):
        return torch.tensor(count, device=device)
