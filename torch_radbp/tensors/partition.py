"""Lanes sorted into queues by torch's own operations, on any device."""

from __future__ import annotations

import torch
from torch import Tensor


def partition_by_torch(number: Tensor, queues: int) -> tuple[Tensor, list[int]]:
    """Sorts lanes into queues, stable; waits for the device once to know the queues' sizes.

    Args:
        number: (N,) bool or integers from 0 to `queues` - 1, which is not checked: the queue of each lane.

    Returns:
        (N,) int32 the lanes, and the number of lanes of each queue.
    """
    dtype = torch.uint8 if queues <= 256 else torch.int32  # a radix sort takes a turn for each byte
    numbers, order = number.to(dtype).sort(stable=True)
    queue = torch.arange(queues, dtype=dtype, device=number.device)
    ends = torch.searchsorted(numbers, queue, right=True).tolist()
    return order.to(torch.int32), [end - first for first, end in zip([0, *ends], ends)]
