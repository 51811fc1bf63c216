"""Scatter-additions: per-lane numbers that are added to entries of tables, or to patches of images."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

PAGE_BITS = 4  # of a table that is noted as touched: 16 entries, two lines of the cache
MOST_TABLES = 3  # of an addition
VALUES = 3  # of patches
SCALARS = {torch.float32: "float", torch.float64: "double"}


class Sums:
    """The float64 sums of some tables of K entries that share one index. Checked once, used often.

    Args:
        totals: of each table, (K, C) float64, written into: the sum over the C copies, a power of 2, counts; at most
            MOST_TABLES. All of one stride: contiguous, or columns of rows.
        touched: (ceil(K / 16),) bool, set for pages of 16 entries that were added to.

    Raises:
        ValueError: if these do not go together, or are not contiguous.
    """

    __slots__ = ("totals", "touched", "device", "copies", "words", "addresses")

    def __init__(self, totals: Sequence[Tensor], touched: Tensor):
        shape, self.device = totals[0].shape, touched.device
        right = (len(totals) <= MOST_TABLES and len(shape) == 2 and shape[1] & (shape[1] - 1) == 0
                 and all(total.dtype == torch.float64 and total.shape == shape and (shape[1] == 1 or total.stride(1) == 1)
                         and total.stride(0) == totals[0].stride(0) >= shape[1] for total in totals)
                 and touched.dtype == torch.bool and touched.is_contiguous() and touched.numel() << PAGE_BITS >= shape[0]
                 and all(total.device == self.device for total in totals))
        if not right:
            found = [(tuple(tensor.shape), tensor.dtype, str(tensor.device)) for tensor in (*totals, touched)]
            raise ValueError(f"sums are up to {MOST_TABLES} totals (K, C) of float64, C a power of 2, and bools for all "
                             f"pages of {1 << PAGE_BITS} entries, of one stride and on one device; got {found}")
        self.totals, self.touched, self.copies = tuple(totals), touched, shape[1]
        # For machine code: the pages, the distance from entry to entry, the number of copies less 1; and the totals.
        self.words = touched.data_ptr(), totals[0].stride(0), self.copies - 1
        self.addresses = [total.data_ptr() for total in totals]


class Addition(NamedTuple):
    """Numbers of N lanes, to be added to entries of some tables at one index."""

    index: Tensor  # (N,) int32
    numbers: Sequence[Tensor]  # for each of the totals, (N,) float32 or float64
    sums: Sums

    def contiguous(self) -> Addition:
        """The addition with contiguous tensors, for machine code."""
        if self.index.is_contiguous() and all([number.is_contiguous() for number in self.numbers]):
            return self
        return self._replace(index=self.index.contiguous(), numbers=[number.contiguous() for number in self.numbers])


class Patches(NamedTuple):
    """Values of N lanes, to be added to rectangles of pixels; all float32 or all float64, (N,) each."""

    first: Tensor  # int32, row-major number of the upper left pixel
    values: Sequence[Tensor]  # VALUES
    down: Sequence[Tensor]  # the weights of the rows of a patch
    across: Sequence[Tensor]  # and of its columns

    def contiguous(self) -> Patches:
        """The patches with contiguous tensors, for machine code."""
        return Patches(self.first.contiguous(), *([part.contiguous() for part in parts] for parts in self[1:]))


def side_by_side(additions: Sequence[Addition]) -> list[list[Addition]]:
    """Groups additions by the tables that they add to, so that no two groups share a table, and may run side by side.

    The largest group comes first; order is kept in each.
    """
    groups: list[tuple[set[int], list[Addition]]] = []  # with the tables that they add to
    for addition in additions:
        tables = set(addition.sums.addresses)
        joined = [group for group in groups if not tables.isdisjoint(group[0])]
        groups = [group for group in groups if tables.isdisjoint(group[0])]
        groups.append((tables.union(*(own for own, _ in joined)),
                       [*(member for _, members in joined for member in members), addition]))
    return sorted([members for _, members in groups], key=len, reverse=True)
