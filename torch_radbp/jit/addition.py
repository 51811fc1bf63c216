"""Numbers of the lanes that are added to entries of tables: what a target has to know of it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

PAGE_BITS = 9  # of a table that is noted as touched: 512 entries, 4 KiB
MOST_TABLES = 3  # of an addition
SCALARS = {torch.float32: "float", torch.float64: "double"}


class Addition(NamedTuple):
    """Numbers of N lanes that are added to entries of some tables of K entries, all at one index."""

    index: Tensor  # (N,) int32
    numbers: Sequence[Tensor]  # of each table, (N,) float32 or float64; at most MOST_TABLES
    totals: Sequence[Tensor]  # of each table, (K, C) float64, written into: the sum over the C copies, a power of 2, counts
    touched: Tensor  # (ceil(K / 512),) bool, set for pages of 512 entries that were added to

    def contiguous(self) -> Addition:
        """The same, for machine code; what is written into is contiguous before."""
        return self._replace(index=self.index.contiguous(), numbers=[number.contiguous() for number in self.numbers])
