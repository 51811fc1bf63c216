"""Gradients of tables: adds each lane's adjoint to the table entry that the lane has read.

A table may have four entries, to which millions of lanes add, or millions, most of which nobody reads. Totals are float64
(one float32 sum loses what is small against the total: 2% of the lamp's gradient at 4 million paths). Memory of large ones
comes zeroed from the operating system when it is first touched, pages that were touched are noted, and only these are
summed over the workers and converted in the end, and are zeroed for the next step (`ZeroedMemory`). Where the totals of one
worker would be larger than `MOST_BESIDE`, there is only one worker, and all threads share each of its loops over lanes.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from itertools import starmap
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.jit.recording.repetitions import Repetitions, read_together
from torch_radbp.jit.scatter import MOST_TABLES, PAGE_BITS, Addition, Sums, copies, scatter_add
from torch_radbp.tensors.least_and_greatest import least_and_greatest
from torch_radbp.threads.team import threads, together, until_none_is_left
from torch_radbp.threads.zeroed_memory import ZeroedMemory, zeros

PAGE = 1 << PAGE_BITS  # entries
PIECE = 1 << 16  # totals that a thread sums at a time: half a megabyte, which its cache holds
MOST_BESIDE = 1 << 26  # bytes of totals that each worker may have beside those of the others
FEW = 1 << 8  # entries of a table below which it takes less to sum several in one go than each


class Contribution(NamedTuple):
    """The adjoints of one table read, to be added to the table's gradient at the indices read."""

    leaf: int  # index of the table
    index: Tensor  # (N,) int32
    adjoint: Tensor  # (N,)


class TableBlock(NamedTuple):
    """Consecutive tables whose gradients are columns of one array."""

    first: int  # first table
    width: int  # number of tables


def blocks_of(tables: Sequence[Tensor]) -> list[TableBlock]:
    """Groups tables into blocks whose gradients are columns of one array."""
    found, first = [], 0
    while first < len(tables):
        width = 1
        while first + width < len(tables) and lie_together(tables[first], tables[first + width]):
            width += 1
        found.append(TableBlock(first, width))
        first += width
    return found


def lie_together(one: Tensor, other: Tensor) -> bool:
    """True if the gradients of two tables belong in one block, of which `one` is the first."""
    if one.dim() != 1 or other.shape != one.shape or (other.dtype, other.device) != (one.dtype, one.device):
        return False
    stride, apart = one.stride(0), other.storage_offset() - one.storage_offset()
    return one.numel() < FEW or (other.stride(0) == stride and 0 < apart < stride
                                 and other.untyped_storage().data_ptr() == one.untyped_storage().data_ptr())


def bytes_of_totals(tables: Iterable[Tensor]) -> int:
    """The memory in bytes in which one worker sums the gradients of some tables."""
    return torch.float64.itemsize * sum([table.numel() for table in tables])


def workers_beside(workers: int, totals: float) -> int:
    """The number of workers that differentiate at the same time, if each needs `totals` bytes: all, or one."""
    return workers if totals <= MOST_BESIDE else 1


class Gradients:
    """The gradients of tables as summed by one worker thread.

    Args:
        tables: (K,) each, or () for a number; of any shape if only whole gradients are added.
        memory: in which sums are kept; None: new memory.
    """

    def __init__(self, tables: Sequence[Tensor], memory: ZeroedMemory | None = None):
        memory = ZeroedMemory() if memory is None else memory
        self.tables, self.blocks = tables, blocks_of(tables)
        self.rows: list[Tensor] = []  # of the totals of each block
        self.totals: list[Tensor] = []  # of each table, (entries, copies)
        for first, width in self.blocks:
            entries, device = tables[first].numel(), tables[first].device
            rows = memory.take(pages(entries) * PAGE, width * copies(entries, device), device)
            self.rows.append(rows)
            self.totals += rows.split(rows.shape[1] // width, 1)
        self.touched = {table.numel(): torch.zeros(pages(table.numel()), dtype=torch.bool, device=table.device)
                        for table in tables}  # by number of entries
        self.sums: dict[tuple[int, ...], Sums] = {}  # of the tables that were added to together

    def add(self, contributions: Iterable[Contribution]) -> None:
        """Adds the adjoints of look-ups of equally many lanes."""
        # Those at the same index of tables of equal length, whose totals lie alike.
        together: dict[tuple[int, int, int], list[Contribution]] = {}
        for part in contributions:
            key = id(part.index), self.tables[part.leaf].numel(), self.totals[part.leaf].stride(0)
            together.setdefault(key, []).append(part)
        additions = []
        for (_, entries, _), parts in together.items():
            for first in range(0, len(parts), MOST_TABLES):
                some = parts[first:first + MOST_TABLES]
                additions.append(Addition(some[0].index, [part.adjoint for part in some],
                                          self.sums_of(tuple([part.leaf for part in some]), entries)))
        scatter_add(additions)

    def sums_of(self, leaves: tuple[int, ...], entries: int) -> Sums:
        """The arrays into which the gradients of some tables with `entries` entries are summed."""
        sums = self.sums.get(leaves)
        if sums is None:
            sums = self.sums[leaves] = Sums([self.totals[leaf] for leaf in leaves], self.touched[entries])
        return sums

    def add_whole(self, leaf: int, gradient: Tensor) -> None:
        """Adds a gradient of the whole table `leaf`."""
        entries = gradient.numel()
        self.totals[leaf][:entries, 0] += gradient.reshape(-1)
        self.touched[entries].fill_(True)


def gradients_of(workers: Sequence[Gradients], repetitions: Repetitions | None = None) -> tuple[list[Tensor], bool]:
    """Sums all workers' gradients in a fixed order, in the tables' shapes and dtypes.

    Tables that are columns of one array get gradients that are columns of one array, too. The workers' sums are zero
    afterwards.

    Returns:
        The gradients; and whether all are finite.

    Raises:
        TooFewRepetitions: if a loop on the device was not repeated to its end.
    """
    tables, results, pieces, size = workers[0].tables, [], [], 0
    touched = {entries: pages_touched([worker.touched[entries] for worker in workers]) for entries in workers[0].touched}
    for number, (first, width) in enumerate(workers[0].blocks):
        table, place = tables[first], touched[tables[first].numel()]
        rows = zeros(pages(table.numel()), PAGE * width, table.dtype, table.device)
        totals = [worker.rows[number].view(len(rows), -1) for worker in workers]
        most = max(1, PIECE // totals[0].shape[1]) if place.is_cpu else max(1, len(place))
        pieces += [(rows, totals, own) for own in place.split(most)]
        size += len(place) * totals[0].shape[1]
        results += [column.view(table.shape) for column in rows.view(-1, width)[:table.numel()].unbind(1)]
    left, written = deque(pieces), []
    count = max(1, min(threads(), size // PIECE))  # a thread that is woken for less takes longer than the work
    together(lambda task: written.extend(starmap(take_over, until_none_is_left(left))), count)
    finite = [torch.isfinite(torch.cat(written)).all()] if written else []
    return results, read_together(finite, repetitions)  # the host waits for the device once


def take_over(rows: Tensor, totals: Sequence[Tensor], place: Tensor) -> Tensor:
    """Moves the workers' sums on touched pages (blocks of entries) into the rows of a gradient.

    Returns:
        Numbers that are all finite if and only if the written ones are.
    """
    total, *others = (own.index_select(0, place) for own in totals)
    for other in others:
        total += other
    for own in totals:
        own.index_fill_(0, place, 0.0)
    total = total.view(len(place), rows.shape[1], total.shape[1] // rows.shape[1])
    total = total.squeeze(2) if total.shape[2] == 1 else total.sum(2)  # torch takes its time to sum one number each
    written = total.to(rows.dtype)
    rows.index_copy_(0, place, written)
    return least_and_greatest(written).double()


def pages_touched(flags: Sequence[Tensor]) -> Tensor:
    """The pages (blocks of entries) that a worker has touched, by index; on a GPU all, to avoid waiting for it."""
    if not flags[0].is_cpu:
        return torch.arange(len(flags[0]), device=flags[0].device)
    return torch.stack(list(flags)).any(0).nonzero().squeeze(1)


def pages(entries: int) -> int:
    """The number of pages (blocks of entries) of a table; the last may be partial."""
    return max(1, -(-entries // PAGE))

