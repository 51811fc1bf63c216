"""Chunks of lanes side by side: one thread a core, each running its operations alone.

Eager torch splits every single operation over all cores. For operations of some ten microseconds the meeting of the threads
after each costs as much as the work, and one busy neighbour holds them all up. Chunks need not meet.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from threading import Barrier
from typing import TypeVar

import torch

Result = TypeVar("Result")


@functools.cache
def pool(threads: int) -> ThreadPoolExecutor:
    """Threads whose torch operations stay on them."""
    everyone = Barrier(threads)

    def stay_alone() -> None:
        torch.get_num_threads()  # a thread takes the default when it first asks, also after it was told another number
        torch.set_num_threads(1)
        everyone.wait()

    executor = ThreadPoolExecutor(threads, thread_name_prefix="torch_radbp")
    for started in [executor.submit(stay_alone) for _ in range(threads)]:
        started.result()
    torch.set_num_threads(threads)  # the number is per thread, but the default of threads to come is not
    return executor


def in_turns(count: int, workers: int, work: Callable[[range], Result]) -> list[Result]:
    """`work` on the numbers 0 to `count` - 1, dealt out to the workers in turn; the results in the workers' order.

    Who gets which number is fixed, so that sums of the results are the same each time.
    """
    workers = min(workers, count)
    shares = [range(worker, count, workers) for worker in range(workers)]
    if workers <= 1:
        return [work(share) for share in shares]
    grad = torch.is_grad_enabled()

    def share_of_work(share: range) -> Result:
        with torch.set_grad_enabled(grad):
            return work(share)

    return [future.result() for future in [pool(torch.get_num_threads()).submit(share_of_work, share) for share in shares]]
