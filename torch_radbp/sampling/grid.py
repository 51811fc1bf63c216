"""A discrete distribution over the cells of a grid, sampled by two binary searches."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.sampling.running_sum import running_sum


class GridSample(NamedTuple):
    """A cell per lane, and a place in it."""

    row: Tensor  # (N,) int64
    column: Tensor  # (N,) int64
    down: Tensor  # (N,) uniform in [0, 1]: the remainder of the number that picked the row
    across: Tensor  # (N,) likewise for the column


class GridDistribution(NamedTuple):
    """Probabilities of R x C cells: first a row, then a cell of it. The tables are float64 whatever the scene's dtype.

    `cells` is one sorted table for all rows, so that one search serves lanes in different rows: the number of the row plus
    the cumulative probability in it.
    """

    rows: Tensor  # (R + 1,) cumulative probability of the rows above
    cells: Tensor  # (1 + R C,) 0, then row + cumulative probability in the row up to and with the cell
    size: tuple[Tensor, Tensor]  # () int64 each, R and C

    def sample(self, u: Tensor, v: Tensor) -> GridSample:
        """Cells for uniform float64 numbers `u` (rows) and `v` (columns) in [0, 1), (N,)."""
        count, columns = self.size
        row = torch.minimum(torch.searchsorted(self.rows, u.contiguous(), right=True) - 1, count - 1)
        above, below = self.rows.index_select(0, row), self.rows.index_select(0, row + 1)
        v = v + row
        # The end of a row is the start of the next, so that the lower bound of a cell is always the entry before it.
        cell = torch.minimum(torch.searchsorted(self.cells, v, right=True) - 1, count * columns - 1)
        left, right = self.cells.index_select(0, cell), self.cells.index_select(0, cell + 1)
        return GridSample(row, cell - row * columns, within(u, above, below), within(v, left, right))


def within(u: Tensor, low: Tensor, high: Tensor) -> Tensor:
    """The position of `u` between two bounds, from 0 to 1."""
    return ((u - low) / (high - low).clamp_min(1e-300)).clamp(0.0, 1.0)


def grid_distribution(weights: Tensor) -> tuple[GridDistribution, Tensor]:
    """The distribution proportional to weights, and the probability of every cell.

    Args:
        weights: (R, C), non-negative, not all zero.

    Returns:
        The distribution, and its (R C,) float64 probabilities.
    """
    weights = weights.detach().to(torch.float64)
    inside = running_sum(weights, 1)
    total = inside[:, -1:]
    rows = torch.nn.functional.pad(running_sum(total[:, 0]), (1, 0))
    # A row that is never picked gets any increasing table.
    inside = torch.where(total > 0, inside / total.clamp_min(1e-300), 1.0)
    first = torch.arange(len(weights), dtype=torch.float64, device=weights.device)[:, None]
    cells = torch.nn.functional.pad((inside + first).reshape(-1), (1, 0))
    size = tuple(torch.tensor(length, device=weights.device) for length in weights.shape)
    return GridDistribution(rows / rows[-1], cells, size), (weights / rows[-1]).reshape(-1)
