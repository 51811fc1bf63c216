"""Lanes sorted into queues by torch's own operations, on any device."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor


def sorted_by_torch(number: Tensor, queues: int) -> tuple[Tensor, Tensor]:
    """Sorts lanes into queues, stable, without waiting for the device: (N,) int32 the lanes, and (queues,) int64 where each
    queue ends. Args as for `partition_by_torch`."""
    dtype = torch.uint8 if queues <= 256 else torch.int32  # a radix sort takes a turn for each byte
    numbers, order = number.to(dtype).sort(stable=True)
    queue = torch.arange(queues, dtype=dtype, device=number.device)
    return order.to(torch.int32), torch.searchsorted(numbers, queue, right=True)


def partition_by_torch(number: Tensor, queues: int) -> tuple[Tensor, list[int]]:
    """Sorts lanes into queues, stable; waits for the device once to know the queues' sizes.

    Args:
        number: (N,) bool or integers from 0 to `queues` - 1, which is not checked: the queue of each lane.

    Returns:
        (N,) int32 the lanes, and the number of lanes of each queue.
    """
    order, ends = sorted_by_torch(number, queues)
    return order, lengths(ends.tolist())


def lengths(ends: Sequence[int]) -> list[int]:
    """The numbers of lanes of consecutive queues, given where each ends in the order of all lanes."""
    return [end - first for first, end in zip([0, *ends], ends)]
