"""Traces chunks in parallel: one thread per core, each with single-threaded torch operations.

Eager torch splits every single operation over all cores. For operations of some ten microseconds the meeting of the threads
after each costs as much as the work, and one busy neighbour holds them all up. Chunks need not meet.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TypeVar

import torch

from torch_radbp.threads.team import Task, alone_in_torch, together, until_none_is_left

Result = TypeVar("Result")


def in_turns(count: int, workers: int, work: Callable[[Iterable[int]], Result]) -> list[Result]:
    """Runs `work` on the numbers 0 to `count` - 1, dealt out to `workers` shares in turn; results in order.

    Which numbers are one share is fixed, so that sums of the results are the same each time; who takes it is not.
    """
    workers = min(workers, count)
    if workers <= 1:
        return [work(range(count))] if count else []
    grad, results = torch.is_grad_enabled(), {}
    shares = deque((worker, range(worker, count, workers)) for worker in range(workers))

    def take_shares(task: Task) -> None:
        with alone_in_torch(threads=1), torch.set_grad_enabled(grad):
            for number, share in until_none_is_left(shares):
                results[number] = work(while_nobody_failed(task, share))

    together(take_shares, workers)
    return [results[worker] for worker in range(workers)]


def by_number(shares: Sequence[Sequence[Result]]) -> list[Result]:
    """The results for the numbers 0, 1, ... that `in_turns` has dealt out to shares; `shares`: of each, in order."""
    return [shares[index % len(shares)][index // len(shares)] for index in range(sum(map(len, shares)))]


def while_nobody_failed(task: Task, share: range) -> Iterator[int]:
    """Yields the numbers of a share, and ends early once there was an error on some thread."""
    for number in share:
        if task.error is not None:
            return
        yield number
