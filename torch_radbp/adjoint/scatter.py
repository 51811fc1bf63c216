"""The gradients of tables that lanes read: each lane's adjoint is added to the entry that it has read.

A table may have four entries, to which millions of lanes add, or millions, most of which nobody reads. Totals are float64
(one float32 sum loses what is small against the total: 2% of the lamp's gradient at 4 million paths). Memory of large ones
comes zeroed from the operating system when it is first touched, pages that were touched are noted, and only these are
summed over the workers and converted in the end.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from torch_radbp.jit.scatter import MOST_TABLES, PAGE_BITS, Addition, Sums, copies, scatter_add

PAGE = 1 << PAGE_BITS  # entries


class Contribution(NamedTuple):
    """What one read of a table adds to its gradient."""

    leaf: int  # which table
    index: Tensor  # (N,) int32
    adjoint: Tensor  # (N,)


class Gradients:
    """The gradients of some tables, as far as one worker has found them.

    Args:
        tables: (K,) each, or () for a number; of any shape if only whole gradients are added.
    """

    def __init__(self, tables: Sequence[Tensor]):
        self.tables = tables
        self.totals = [zeros(pages(table.numel()) * PAGE, copies(table.numel(), table.device), torch.float64,
                             table.device)
                       for table in tables]
        self.touched = {table.numel(): torch.zeros(pages(table.numel()), dtype=torch.bool, device=table.device)
                        for table in tables}  # by number of entries
        self.sums: dict[tuple[int, ...], Sums] = {}  # of the tables that were added to together

    def add(self, contributions: Iterable[Contribution]) -> None:
        """Adds what reads of equally many lanes contribute."""
        together: dict[tuple[int, int], list[Contribution]] = {}  # those of tables of equal length at the same index
        for part in contributions:
            together.setdefault((id(part.index), self.tables[part.leaf].numel()), []).append(part)
        additions = []
        for (_, entries), parts in together.items():
            for first in range(0, len(parts), MOST_TABLES):
                some = parts[first:first + MOST_TABLES]
                additions.append(Addition(some[0].index, [part.adjoint for part in some],
                                          self.sums_of(tuple([part.leaf for part in some]), entries)))
        scatter_add(additions)

    def sums_of(self, leaves: tuple[int, ...], entries: int) -> Sums:
        """What is added to for some tables with so many entries."""
        sums = self.sums.get(leaves)
        if sums is None:
            sums = self.sums[leaves] = Sums([self.totals[leaf] for leaf in leaves], self.touched[entries])
        return sums

    def add_whole(self, leaf: int, gradient: Tensor) -> None:
        """Adds to the gradient of a whole table."""
        entries = gradient.numel()
        self.totals[leaf][:entries, 0] += gradient.reshape(-1)
        self.touched[entries].fill_(True)


def gradients_of(workers: Sequence[Gradients]) -> list[Tensor]:
    """The gradients, in the tables' shapes and dtypes, from those that each worker has found.

    They are summed in the workers' order.
    """
    results = []
    for leaf, table in enumerate(workers[0].tables):
        touched = pages_touched([worker.touched[table.numel()] for worker in workers])
        parts = [worker.totals[leaf].view(pages(table.numel()), -1).index_select(0, touched) for worker in workers]
        for part in parts[1:]:
            parts[0] += part
        total = parts[0].view(len(touched), PAGE, workers[0].totals[leaf].shape[1])
        total = total.squeeze(2) if total.shape[2] == 1 else total.sum(2)  # torch takes its time to sum one number each
        gradient = zeros(pages(table.numel()), PAGE, table.dtype, table.device)
        gradient.index_copy_(0, touched, total.to(table.dtype))
        results.append(gradient.view(-1)[:table.numel()].view(table.shape))
    return results


def pages_touched(flags: Sequence[Tensor]) -> Tensor:
    """The numbers of the pages that a worker has touched; elsewhere than on the CPU all, which asks the device nothing."""
    if not flags[0].is_cpu:
        return torch.arange(len(flags[0]), device=flags[0].device)
    return torch.stack(list(flags)).any(0).nonzero().squeeze(1)


def pages(entries: int) -> int:
    """The number of pages of a table, the last perhaps not full."""
    return max(1, -(-entries // PAGE))


def zeros(rows: int, columns: int, dtype: torch.dtype, device: torch.device) -> Tensor:
    """Zeros whose memory, on the CPU, is not taken before it is touched."""
    if device.type != "cpu":
        return torch.zeros(rows, columns, dtype=dtype, device=device)
    return torch.from_numpy(np.zeros((rows, columns), dtype=torch.empty(0, dtype=dtype, device=device).numpy().dtype))
