"""Sequences of launches that come again, as CUDA graphs: one call of the driver starts all of their kernels.

Where shapes repeat, a step starts the same kernels as the last one, and torch's allocator hands out the same memory for them:
each kernel is given the very words that it was given before. Those are the steps that have a graph. It is found by all of
these words, so that none is ever started with others; and it is made when they come for the second time, since a sequence
that never comes again is not worth a graph, which takes longer to make than to launch.

Reference: NVIDIA, CUDA Driver API, "Graph Management".
"""

from __future__ import annotations

from collections.abc import Callable
from threading import Lock
from typing import Any

MOST_GRAPHS = 64  # of one sequence: bounces of a call, times the wavefronts of it that lie in memory of their own
ONCE = object()  # in the place of the graph of words that came once


class Graphs:
    """The graphs of one sequence, by all that its launches are given; of those that came last."""

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
