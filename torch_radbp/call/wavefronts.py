"""Wavefronts: several chunks whose lanes are traced together.

A wavefront of some thousand lanes takes about as long as one of twice as many, most of it in Python. So small images of
several sensors, such as all views of a step of an optimisation, are traced together.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Sequence
from itertools import groupby
from typing import NamedTuple

from torch_radbp.call.chunks import LEAST_LANES, Chunk, LaneBlock


class Wavefront(NamedTuple):
    """Chunks whose lanes are traced together, one chunk after the other."""

    chunks: tuple[LaneBlock, ...]

    @property
    def lanes(self) -> int:
        return sum(chunk.lanes for chunk in self.chunks)

    @property
    def group(self) -> int:
        """The number of the group to which all of its chunks belong; groups are traced one after the other."""
        return self.chunks[0].group

    def parts(self) -> Iterator[tuple[LaneBlock, int, int]]:
        """Yields each chunk with the index of its first lane and that after its last."""
        first = 0
        for chunk in self.chunks:
            yield chunk, first, first + chunk.lanes
            first += chunk.lanes


def plan_wavefronts(chunks: Sequence[Chunk], alike: Callable[[Chunk], Hashable], lanes: int,
                    workers: int) -> list[Wavefront]:
    """Joins successive chunks to as few wavefronts as possible, but at least one per worker if there is enough work.

    Args:
        chunks: of a call.
        alike: returns equal values for chunks that may be traced together; None: for one that may not.
        lanes: the most lanes of a wavefront, except for a single chunk.
        workers: the number of threads to which wavefronts are dealt in turn.
    """
    found = []
    for (_, joins), members in groupby(chunks, lambda chunk: (chunk.group, alike(chunk))):
        own = list(members)
        count = len(own) if joins is None else number_of([chunk.lanes for chunk in own], lanes, workers)
        borders = [len(own) * number // count for number in range(count + 1)]
        found += [Wavefront(tuple(own[slice(*pair)])) for pair in zip(borders, borders[1:])]
    return found


def number_of(sizes: Sequence[int], lanes: int, workers: int) -> int:
    """The number of wavefronts into which chunks of these sizes are joined; args as for `plan_wavefronts`."""
    most = max(1, lanes // max(sizes))  # chunks of one
    count = max(1, -(-len(sizes) // most), min(workers, sum(sizes) // LEAST_LANES))
    fair = -(-count // workers) * workers if count > workers else count
    return min(len(sizes), fair)
