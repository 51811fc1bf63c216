"""Sequences of launches that come again, as CUDA graphs: one call of the driver starts all of their kernels.

Where shapes repeat, a step starts the same kernels as the last one. If they work in the same memory, too, each kernel is
given the very words that it was given before: those are the sequences that have a graph. It is found by all of these words,
so that none is ever started with others; and it is made when they come for the second time, since a sequence that never
comes again is not worth a graph, which takes longer to make than to launch.

Whether memory is the same is up to allocators. That of torch cuts blocks and joins them, so that the many that a step takes
may wander about for long; so those of sequences are kept here, by their sizes, and handed out in the same order in each
step. What torch itself computes in a step, such as packed parameters, mostly lies where it lay one or two steps ago.

Of many lanes kernels take longer than their launches. They have no graphs, and the memory that torch hands out.

Reference: NVIDIA, CUDA Driver API, "Graph Management".
"""

from __future__ import annotations

from collections.abc import Callable
from threading import Lock
from typing import Any

import torch
from torch import Tensor

from torch_radbp.tensors.torch_internals import holders

MOST_LANES = 1 << 16  # of sequences that have graphs
MOST_GRAPHS = 64  # of one sequence: bounces of a call, times the wavefronts of it that lie in memory of their own
MOST_BYTES = 256 << 20  # that are kept for sequences
ONCE = object()  # in the place of the graph of words that came once


class Graphs:
    """The CUDA graphs of one sequence of launches, by all that its kernels are given; only the last few are kept."""

    def __init__(self) -> None:
        self.known: dict[bytes, Any] = {}
        self.asking = Lock()

    def of(self, given: bytes, make: Callable[[], Any]) -> Any:
        """The graph of a sequence.

        Args:
            given: all that its launches are given.
            make: makes the graph; None: it cannot be made.

        Returns:
            None if there is none, and the kernels are to be launched one by one.
        """
        with self.asking:
            came = given in self.known
            graph = self.known.pop(given, None)
            if graph is ONCE:
                graph = make()
            if len(self.known) >= MOST_GRAPHS:
                self.known.pop(next(iter(self.known)))
            self.known[given] = graph if came else ONCE
            return graph


class SequenceMemory:
    """Memory of a device that sequences of launches work in: blocks that nobody holds are handed out again.

    A block serves the stream that it was made for, as those of torch's allocator do: what is launched there later may have
    it while what was launched before still runs.
    """

    def __init__(self) -> None:
        self.blocks: dict[tuple[int, int], list[torch.UntypedStorage]] = {}  # by stream and bytes
        self.bytes = 0  # of all
        self.asking = Lock()

    def room(self, size: int, stream: int, device: torch.device) -> Tensor:
        """Bytes of a device, to be used on a stream."""
        with self.asking:
            blocks = self.blocks.setdefault((stream, size), [])
            block = next((block for block in blocks if holders(block) == 1), None)
            if block is None:
                if self.bytes + size > MOST_BYTES:
                    self.release()
                block = torch.empty(size, dtype=torch.uint8, device=device).untyped_storage()
                if self.bytes + size <= MOST_BYTES and holders(block) == 1:
                    self.bytes += size
                    blocks.append(block)
            return torch.empty(0, dtype=torch.uint8, device=device).set_(block)

    def release(self) -> None:
        """Gives blocks that nobody holds back to torch's allocator."""
        for (_, size), blocks in self.blocks.items():
            held = [block for block in blocks if holders(block) > 1]
            self.bytes -= size * (len(blocks) - len(held))
            blocks[:] = held
