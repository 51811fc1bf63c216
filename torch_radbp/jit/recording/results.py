"""What a recording is given, and where the results of all that was recorded lie; the same for every target."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torch_radbp.jit.recording.lane_operations import LaneSpan, MemoryPlace, Operation, Outside
from torch_radbp.jit.recording.recording import NotRecordable, Recording
from torch_radbp.jit.recording.structure import Leaf, assembler, flatten, with_other_leaves

SIZES = (1, 4, 8)  # bytes of a tensor's entries


class RecordedInputs:
    """The inputs of a recorded function: tensors, and addresses of memory that its loops read."""

    __slots__ = ("items", "addresses", "lengths")

    def __init__(self, items: Sequence[Tensor | int]):
        self.items = items
        self.addresses = array("q", [item if type(item) is int else item.data_ptr() for item in items])
        self.lengths = array("q", [0 if type(item) is int else item.numel() for item in items])

    @property
    def pattern(self) -> tuple[int, ...]:
        """For each input the index of the first input at the same address; one recording serves calls of equal patterns."""
        firsts: dict[int, int] = {}
        return tuple(map(firsts.setdefault, self.addresses, range(len(self.addresses))))


class ResultGroup(NamedTuple):
    """Results with the same dtype and number of lanes, which are rows of one tensor.

    They are of one part of what a step returns: who keeps one part of it keeps no memory of the others.
    """

    dtype: torch.dtype
    lanes: LaneSpan
    part: int
    tensors: list[int]  # indices of the tensors
    handed: bool = False  # True: a tensor that outside work returns


class ResultLayout:
    """The memory layout of the tensors that a recording makes: results in groups, temporaries in rows that are reused.

    Args:
        recording: whose tensors are laid out.
        results: the numbers of the tensors that are returned, with the part of the results that each belongs to.
    """

    def __init__(self, recording: Recording, results: Sequence[tuple[int, int]]):
        self.groups: list[ResultGroup] = []
        self.rows: dict[int, tuple[int, int]] = {}  # of each result the group and the row
        for operation in recording.operations:
            for place in operation.outputs if isinstance(operation, Outside) else ():
                dtype, lanes = recording.made[place.tensor]
                self.rows[place.tensor] = len(self.groups), 0
                self.groups.append(ResultGroup(dtype, lanes, 0, [place.tensor], True))
        for number, part in results:
            if number in self.rows:
                continue
            dtype, lanes = recording.made[number]
            group = next((group for group in self.groups if group[:3] == (dtype, lanes, part) and not group.handed), None)
            if group is None:
                self.groups.append(group := ResultGroup(dtype, lanes, part, []))
            self.rows[number] = self.groups.index(group), len(group.tensors)
            group.tensors.append(number)
        self.bytes = 0  # of all rows of the rest, for each lane
        self.at: dict[int, int] = {}  # of each of the rest, the bytes for each lane that lie before it
        free: dict[int, list[int]] = {size: [] for size in SIZES}
        reads = [set(made_in(operation)) for operation in recording.operations]
        last = {number: place for place, read in enumerate(reads) for number in read}
        for place, read in enumerate(reads):
            for number in sorted(read):
                size = recording.made[number].dtype.itemsize
                if number not in self.at and number not in self.rows:
                    if not free[size]:
                        free[size].append(self.bytes)
                        self.bytes += size
                    self.at[number] = free[size].pop()
            for number in read:
                if last[number] == place and number in self.at:
                    free[recording.made[number].dtype.itemsize].append(self.at[number])


def made_in(operation: Operation) -> Iterator[int]:
    """The indices of made tensors that an operation reads or writes."""
    waiting = list(operation)
    while waiting:
        item = waiting.pop()
        if isinstance(item, MemoryPlace):
            if item.made:
                yield item.tensor
        elif isinstance(item, tuple) and not isinstance(item, LaneSpan):
            waiting.extend(item)


class ResultPlace(NamedTuple):
    """The place in memory of a recorded function's result."""

    group: int  # index in `ResultLayout.groups`; GIVEN: an input; EMPTY: no lanes
    row: int  # row of the group, or index of the input
    count: int  # index of the count of its entries; WHOLE: as the group


GIVEN, EMPTY, WHOLE = -2, -1, -1


class RecordedResults:
    """The results of a recorded function, and where in memory they lie.

    Args:
        recording: of the function.
        given: the function's inputs.
        results: what the function returned: tensors in nested tuples, whose parts lie in memory of their own.
    """

    def __init__(self, recording: Recording, given: Sequence[Tensor | int], results: Any):
        leaves: list[Tensor] = []
        parts: list[int] = []  # of each leaf
        for number, part in enumerate(results if type(results) is tuple else (results,)):
            flatten(part, leaves, [])
            parts += [number] * (len(leaves) - len(parts))
        places = [recording.place(leaf) if leaf.numel() else None for leaf in leaves]
        self.assemble: Callable[[list[Tensor]], Any] = assembler(with_other_leaves(results, Leaf))
        self.layout = ResultLayout(recording, [
            (place.tensor, part) for place, part in zip(places, parts) if place and place.made])
        self.empty: list[torch.dtype] = []  # of results without lanes, which are new each time
        self.found = [self.where(place, recording.span(leaf.numel()), leaf.dtype) for place, leaf in zip(places, leaves)]
        self.rays, self.counts = recording.rays, recording.counts

    def where(self, place: MemoryPlace | None, lanes: LaneSpan, dtype: torch.dtype) -> ResultPlace:
        """The memory of a result; `place`: None if it has no lanes."""
        if place is None:
            self.empty.append(dtype)
            return ResultPlace(EMPTY, len(self.empty) - 1, WHOLE)
        if not place.made:
            return ResultPlace(GIVEN, place.tensor, WHOLE)
        group, row = self.layout.rows[place.tensor]
        if lanes == self.layout.groups[group].lanes:
            return ResultPlace(group, row, WHOLE)
        if place.first or lanes.first:
            raise NotRecordable("a result is a part of a tensor that does not begin where it does")
        return ResultPlace(group, row, lanes.last)
