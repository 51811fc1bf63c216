"""The operations that a `Recording` consists of."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import torch


class LaneSpan(NamedTuple):
    """Lanes between two counts, by their numbers; count 0 is zero, count 1 all lanes."""

    first: int
    last: int


class MemoryPlace(NamedTuple):
    """Where a loop reads or writes."""

    made: bool  # a tensor that was made while recording; else one that is given
    tensor: int  # its number
    first: int = 0  # the number of the count of entries that come before
    size: int = 4  # bytes of an entry


class LoopBody(Protocol):
    """A loop's body that may not have been compiled yet."""

    @property
    def address(self) -> int:
        """Where it lies, once it has been; see `team.LaneLoop`."""


class RecordedLoop(NamedTuple):
    """A loop over lanes."""

    body: int | LoopBody  # or its address
    lanes: LaneSpan
    part: int
    inputs: tuple[MemoryPlace, ...]
    lengths: tuple[LaneSpan, ...] | None  # of those that were made; None: lengths are not read
    outputs: tuple[MemoryPlace, ...]
    of_lanes: tuple[bool, ...] = ()  # of each input whether it has an entry for each lane; (): nobody asks


class Partition(NamedTuple):
    """`order.partition`."""

    number: MemoryPlace
    lanes: LaneSpan
    queues: int
    order: MemoryPlace
    first: int  # the number of the first count that it finds: where the queue 1 begins


class Chosen(NamedTuple):
    """`order.chosen`."""

    flags: MemoryPlace
    lanes: LaneSpan
    order: MemoryPlace
    count: int  # the number of the count that it finds


class Put(NamedTuple):
    """`order.put`, of entries of one size."""

    place: MemoryPlace
    lanes: LaneSpan
    pairs: tuple[tuple[MemoryPlace, MemoryPlace], ...]  # entry and target


class Inverted(NamedTuple):
    """`order.inverted`, or `order.nothing` where there are no flags."""

    flags: MemoryPlace | None
    lanes: LaneSpan
    result: MemoryPlace


class Copy(NamedTuple):
    """Entries of one tensor, to another: a result that is the same as one before, see `LaneFunction.into`."""

    source: MemoryPlace
    target: MemoryPlace
    lanes: LaneSpan


class Added(NamedTuple):
    """An `Addition` of `scatter.scatter_add`."""

    loop: Any  # address of the function, or whatever a target calls it by
    index: MemoryPlace
    touched: MemoryPlace
    step: int  # from entry to entry of the totals
    mask: int  # the number of copies less 1
    numbers: tuple[MemoryPlace, ...]
    totals: tuple[MemoryPlace, ...]


class Scattered(NamedTuple):
    """`scatter.scatter_add`."""

    groups: tuple[tuple[Added, ...], ...]  # that may run side by side
    lanes: LaneSpan


class OutsideWork(NamedTuple):
    """What is given outside of some lanes, and handed back for them."""

    lanes: LaneSpan
    inputs: tuple[MemoryPlace, ...]
    outputs: tuple[MemoryPlace, ...]


class Outside(NamedTuple):
    """What is done by others than machine code, see `recording.outside`."""

    work: Callable
    context: int  # which of those that the recording is told
    parts: tuple[OutsideWork, ...]

    @property
    def outputs(self) -> tuple[MemoryPlace, ...]:
        """Of all parts."""
        return tuple(place for part in self.parts for place in part.outputs)


class NewTensor(NamedTuple):
    """A tensor that was made while recording."""

    dtype: torch.dtype
    lanes: LaneSpan


Operation = RecordedLoop | Partition | Chosen | Put | Inverted | Copy | Scattered | Outside
