"""Batches of photographs of one size each."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import torch
from torch.utils.data import Sampler

from torch_radbp.plugin import boolean, integer


class SizeBatches(Sampler[list[int]]):
    """Lists of indices of photographs that have one size: what `DataLoader(photographs, batch_sampler=)` takes.

    Each photograph comes once an epoch; the last batch of each size may be smaller.

    Args:
        sizes: width and height of each photograph.
        batch_size: of a batch, at most.
        shuffle: whether photographs, and batches of different sizes, come in random order.
        generator: of the random numbers; None: torch's.
    """

    def __init__(self, sizes: Sequence[tuple[int, int]], batch_size: int, shuffle: bool,
                 generator: torch.Generator | None = None):
        self.sizes, self.batch_size = list(sizes), integer("batch_size", batch_size, 1)
        self.shuffle, self.generator = boolean("shuffle", shuffle), generator

    def order(self, count: int) -> list[int]:
        """The indices below `count` in the order of this epoch."""
        return torch.randperm(count, generator=self.generator).tolist() if self.shuffle else list(range(count))

    def __iter__(self) -> Iterator[list[int]]:
        of_size: dict[tuple[int, int], list[int]] = {}
        for view in self.order(len(self.sizes)):
            of_size.setdefault(self.sizes[view], []).append(view)
        batches = [views[first:first + self.batch_size] for views in of_size.values()
                   for first in range(0, len(views), self.batch_size)]
        return iter([batches[number] for number in self.order(len(batches))])

    def __len__(self) -> int:
        return sum(-(-self.sizes.count(size) // self.batch_size) for size in set(self.sizes))
