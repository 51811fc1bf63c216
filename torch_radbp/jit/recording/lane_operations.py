"""The operations of which a `Recording` consists."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import torch


class LaneSpan(NamedTuple):
    """The lanes between two counts, given by their indices; count 0 is zero, count 1 all lanes."""

    first: int
    last: int


class MemoryPlace(NamedTuple):
    """The memory that a recorded loop reads or writes: a tensor and an offset."""

    made: bool  # True: a tensor made while recording; False: one that is given
    tensor: int  # index of the tensor
    first: int = 0  # index of the count that is the offset in entries
    size: int = 4  # bytes per entry


class LoopBody(Protocol):
    """The body of a loop, perhaps not yet compiled."""

    @property
    def address(self) -> int:
        """The address of the compiled code, a C function that takes parts of a `team.Job`."""

    def takes(self, lanes: int) -> bool:
        """Counts lanes that the loop computes; False if its address will not change any more, as by better code."""


class RecordedLoop(NamedTuple):
    """A recorded call of a compiled loop over lanes."""

    body: int | LoopBody  # address, or body that is being compiled
    lanes: LaneSpan
    part: int
    inputs: tuple[MemoryPlace, ...]
    lengths: tuple[LaneSpan, ...] | None  # of tensors made while recording; None: lengths are not read
    outputs: tuple[MemoryPlace, ...]
    of_lanes: tuple[bool, ...] = ()  # of each input whether it has an entry for each lane; (): nobody asks


class Partition(NamedTuple):
    """A recorded sorting of lanes into queues, `order.partition`."""

    number: MemoryPlace
    lanes: LaneSpan
    queues: int
    order: MemoryPlace
    first: int  # index of the first count that it yields: where queue 1 begins


class Chosen(NamedTuple):
    """A recorded selection of the lanes whose flags are set, `order.chosen`."""

    flags: MemoryPlace
    lanes: LaneSpan
    order: MemoryPlace
    count: int  # index of the count that it yields


class Put(NamedTuple):
    """A recorded scatter of entries of one size into tensors, `order.put`."""

    place: MemoryPlace
    lanes: LaneSpan
    pairs: tuple[tuple[MemoryPlace, MemoryPlace], ...]  # source and target of each tensor


class Inverted(NamedTuple):
    """A recorded negation of flags; without flags, one that sets all lanes' flags to false."""

    flags: MemoryPlace | None
    lanes: LaneSpan
    result: MemoryPlace


class Copy(NamedTuple):
    """A recorded copy between tensors, for a result of a loop that equals another one, or an argument."""

    source: MemoryPlace
    target: MemoryPlace
    lanes: LaneSpan


class Added(NamedTuple):
    """One addition of lanes' numbers to tables at one index, as a part of a recorded scatter-add."""

    loop: Any  # address of the function, or whatever a target calls it by
    index: MemoryPlace
    touched: MemoryPlace
    step: int  # stride between entries of the sums
    mask: int  # number of copies less 1
    numbers: tuple[MemoryPlace, ...]
    totals: tuple[MemoryPlace, ...]


class Scattered(NamedTuple):
    """A recorded scatter-add of lanes' numbers to tables, `scatter.scatter_add`."""

    groups: tuple[tuple[Added, ...], ...]  # groups that may run in parallel
    lanes: LaneSpan


class OutsideWork(NamedTuple):
    """The inputs and outputs of work outside of machine code for one group of lanes."""

    lanes: LaneSpan
    inputs: tuple[MemoryPlace, ...]
    outputs: tuple[MemoryPlace, ...]


class Outside(NamedTuple):
    """Recorded work outside of machine code, such as a neural network: a Python function that is called again."""

    work: Callable
    context: int  # index of the context passed to it
    parts: tuple[OutsideWork, ...]

    @property
    def outputs(self) -> tuple[MemoryPlace, ...]:
        """The places of the outputs of all groups of lanes."""
        return tuple(place for part in self.parts for place in part.outputs)


class NewTensor(NamedTuple):
    """A tensor that a recorded operation makes, with an entry for each lane of a span."""

    dtype: torch.dtype
    lanes: LaneSpan


class Repeated(NamedTuple):
    """A recorded sequence of operations that is repeated until no lane goes on, `order.repeated`."""

    lanes: MemoryPlace  # of which the operations are done; those that go on are copied there
    start: LaneSpan  # how many there are at first
    count: int  # index of the count of those that there are each time
    operations: tuple[Operation, ...]
    rest: MemoryPlace  # those that go on
    left: LaneSpan
    rays: tuple[LaneSpan, ...]  # that are cast each time
    cast: int  # index of the count of rays that are cast in all


Operation = RecordedLoop | Partition | Chosen | Put | Inverted | Copy | Scattered | Outside | Repeated
