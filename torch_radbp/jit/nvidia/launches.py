"""Kernels that do what a recording has noted, launched one after the other; the host waits for nothing.

Numbers of lanes that are found on the way stay on the device: each kernel is launched for as many lanes as there may be, and
reads which of them there are. So a tensor has room for all lanes, and what belongs to the lanes between two counts stands in
it from the first count on. Where everything lies is known before the first launch; the words that kernels are given are sums
of an address and a distance, and are computed together.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol

import torch

from torch_radbp.jit.nvidia.graphs import Graphs
from torch_radbp.jit.nvidia.nvptx import BLOCK
from torch_radbp.jit.nvidia.nvptx_lanes import copy_text, counts_text, move_text, put_text, scatter_text
from torch_radbp.jit.nvidia.nvptx_order import GROUP, MOST_QUEUES, RUN, count_text, place_text, sum_text
from torch_radbp.jit.recording.lane_operations import (
    Chosen,
    Copy,
    Inverted,
    LaneSpan,
    MemoryPlace,
    NewTensor,
    Operation,
    Outside,
    Partition,
    Put,
    RecordedLoop,
    Scattered,
)
from torch_radbp.jit.recording.recording import NotRecordable
from torch_radbp.jit.recording.results import ResultLayout

OF_SIZE = {1: torch.bool, 4: torch.int32, 8: torch.int64}  # entries that are moved, by their bytes
BLOCKS = "nothing", "counts", "scratch", "room"  # of memory, that words may point into; behind these come results


class RayQuery(NamedTuple):
    """A recorded query of rays, which the device's ray caster answers by launching its own `kernel`."""

    kernel: Any

    @property
    def address(self) -> int:
        raise NotRecordable("rays are cast by the device")


class Caster(Protocol):
    """What casts rays on a device."""

    def launch(self, kernel: Any, lanes: int, last: int, *addresses: int) -> None:
        """Casts a ray for each lane, and does not wait for it.

        Args:
            kernel: that was recorded.
            lanes: as many as there may be.
            last: the address of their number, int64.
            addresses: of what the kernel reads and writes.
        """

    def given(self) -> bytes:
        """The bytes that `launch` hands to kernels beside its own arguments; they are about to read what these point to."""


class Word(NamedTuple):
    """A 64-bit argument of a kernel: the address of a block of memory plus a distance from there, in bytes."""

    block: int  # whose address it is; 0: none
    distance: int


class Launch(NamedTuple):
    """A kernel that is launched."""

    kernel: Any  # a `LoadedKernel`, or a `RayQuery`
    blocks: int
    first: int  # of its words
    last: int


class Part(NamedTuple):
    """Launches of kernels that follow each other without anything that the host does."""

    launches: Sequence[Launch]
    words: slice  # theirs, of those of all launches
    outside: Outside | None  # what is done afterwards; None: nothing
    casts: bool  # a `Caster` is needed
    graphs: Graphs


class DeviceRecording(NamedTuple):
    """A recording as its launches are made from it: operations, tensors that these make, their places, and inputs."""

    kernel: Callable  # from name, case and text, see `gpu.Gpu.kernel`
    operations: Sequence[Operation]
    made: Sequence[NewTensor]
    layout: ResultLayout
    given: Sequence[LaneSpan | None]  # tensors and addresses, with the lanes for which tensors have entries; None: unknown
    known: int  # counts that are known before the first launch, that of all lanes among them

    @property
    def first_given(self) -> int:
        """The number of the first input among all blocks of memory: working memory and results come before inputs, and the
        inputs' lengths and known counts after them."""
        return len(BLOCKS) + len(self.layout.groups)

    @property
    def first_length(self) -> int:
        return self.first_given + len(self.given)

    @property
    def first_count(self) -> int:
        return self.first_length + len(self.given)


def done_together(operation: Operation) -> tuple:
    """A key that is equal for two successive operations if one launch does both."""
    if isinstance(operation, Put):
        return Put, operation.place, operation.lanes
    return (Copy, operation.lanes) if isinstance(operation, Copy) else (type(operation),)


class Launches:
    """The launches of a recording for so many lanes.

    Args:
        of: the recording.
        lanes: as many as there may be; so many entries is each tensor long.
    """

    def __init__(self, of: DeviceRecording, lanes: int):
        self.of, self.lanes = of, lanes
        self.sequence: list[Launch] = []
        self.words: list[Word] = []
        self.scratch = 0  # bytes
        self.parts: list[Part] = []
        self.add(of.kernel("counts", (of.known,), counts_text), 1, [
            self.literal(1), *[Word(0, 0)] * 2, self.counts(0),
            *[Word(of.first_count + place, 0) for place in range(2 * of.known)]])
        write = {RecordedLoop: self.loop, Partition: self.partition, Chosen: self.chosen, Put: self.put,
                 Inverted: self.inverted, Copy: self.copy, Scattered: self.scattered, Outside: self.part}
        for kind, run in itertools.groupby(of.operations, done_together):
            if kind[0] in (Copy, Put):
                write[kind[0]](list(run))
            else:
                for operation in run:
                    write[type(operation)](operation)
        self.part(None)
        self.blocks = torch.tensor([word.block for word in self.words], dtype=torch.int64, device="cpu")
        self.distances = torch.tensor([word.distance for word in self.words], dtype=torch.int64, device="cpu")

    # -- Words ----------------------------------------------------------------------------------------------------------

    @staticmethod
    def literal(number: int) -> Word:
        return Word(0, number)

    @staticmethod
    def counts(number: int) -> Word:
        """The address of the count of lanes with this number, as a kernel's argument."""
        return Word(BLOCKS.index("counts"), 8 * number)

    def part(self, outside: Outside | None) -> None:
        """Ends a part of the launches, after which the host does work `outside` of kernels; None: the last part."""
        known = sum(len(part.launches) for part in self.parts)
        words = slice(self.parts[-1].words.stop if self.parts else 0, len(self.words))
        launches = self.sequence[known:]
        casts = any(isinstance(launch.kernel, RayQuery) for launch in launches)
        self.parts.append(Part(launches, words, outside, casts, Graphs()))

    def place(self, place: MemoryPlace) -> Word:
        """The address of a tensor as a kernel's argument: a block of memory, known when kernels start, and a distance."""
        if not place.made:
            return Word(self.of.first_given + place.tensor, 0)
        layout = self.of.layout
        if place.tensor in layout.rows:
            group, row = layout.rows[place.tensor]
            return Word(len(BLOCKS) + group, row * self.lanes * place.size)
        return Word(BLOCKS.index("room"), layout.at[place.tensor] * self.lanes)

    def of_span(self, place: MemoryPlace, lanes: LaneSpan) -> Word:
        """The address of a tensor with entries for a span of lanes, which stand at these lanes' places in room for all."""
        first = self.first_of(place)
        if first != lanes.first:
            raise NotRecordable("entries of lanes do not stand where the lanes do")
        return self.place(place)

    def whole(self, place: MemoryPlace) -> Word:
        """The address of a tensor that is read at indices, as a table."""
        if self.first_of(place):
            raise NotRecordable("a table begins where only the device knows")
        return self.place(place)

    def first_of(self, place: MemoryPlace) -> int:
        """The count at which the entries of a place begin in the room for all lanes."""
        lanes = self.of.made[place.tensor].lanes if place.made else self.of.given[place.tensor]
        before = 0 if lanes is None else lanes.first
        if before and place.first:
            raise NotRecordable("a part of what belongs to a part of the lanes")
        return before or place.first

    # -- Launches -------------------------------------------------------------------------------------------------------

    def add(self, kernel: Any, threads: int, words: Sequence[Word]) -> None:
        """Adds the launch of a kernel."""
        first = len(self.words)
        self.words += words
        self.sequence.append(Launch(kernel, -(-threads // BLOCK), first, len(self.words)))

    def over(self, kernel: Any, lanes: LaneSpan, words: Sequence[Word]) -> None:
        """Adds the launch of a kernel over some lanes."""
        if lanes.first != lanes.last:
            borders = self.counts(lanes.first), self.counts(lanes.last)
            self.add(kernel, self.lanes, [self.literal(self.lanes), *borders, *words])

    def of_threads(self, name: str, case: tuple, text, threads: int, words: Sequence[Word]) -> None:
        """Adds the launch of a kernel for so many threads."""
        self.add(self.of.kernel(name, case, text), threads, [self.literal(threads), *[Word(0, 0)] * 2, *words])

    def loop(self, operation: RecordedLoop) -> None:
        body, lanes = operation.body, operation.lanes
        outputs = [self.of_span(place, lanes) for place in operation.outputs]
        if isinstance(body, RayQuery):
            if lanes.first:
                raise NotRecordable("rays are cast for a part of the lanes")
            inputs = [self.of_span(place, lanes) for place in operation.inputs]
            if lanes.last:
                self.add(body, self.lanes, [self.counts(lanes.last), *inputs, *outputs])
            return
        if isinstance(body, int):
            raise NotRecordable("a loop is for the processor")
        loop = body.loop.result()
        inputs = [self.of_span(place, lanes) if each else self.whole(place)
                  for place, each in zip(operation.inputs, operation.of_lanes)]
        lengths = []
        for number in loop.searched:
            if operation.inputs[number].made:
                raise NotRecordable("what is searched is as long as only the device knows")
            lengths.append(Word(self.of.first_length + operation.inputs[number].tensor, 0))
        self.over(loop.kernel, lanes, [*inputs, *lengths, *outputs])

    def partition(self, operation: Partition) -> None:
        self.ordered(operation.number, operation.lanes, operation.queues, False, operation.order, operation.first)

    def chosen(self, operation: Chosen) -> None:
        self.ordered(operation.flags, operation.lanes, 1, True, operation.order, operation.count)

    def ordered(self, number: MemoryPlace, lanes: LaneSpan, queues: int, flags: bool, order: MemoryPlace,
                count: int) -> None:
        """Adds the kernels that put lanes into queues, and write where queues begin as counts from number `count` on."""
        if queues > MOST_QUEUES:
            raise NotRecordable(f"{queues} queues are too many")
        runs = -(-self.lanes // RUN)
        sizes = [queues * runs]
        while len(sizes) == 1 or sizes[-1] > 1:
            sizes.append(-(-sizes[-1] // GROUP))
        sums, levels = [], len(sizes) - 1
        at = 0
        for size in sizes:
            sums.append(Word(BLOCKS.index("scratch"), at))
            at += 4 * size
        self.scratch = max(self.scratch, at)
        read, total = self.of_span(number, lanes), self.counts(lanes.last)
        self.of_threads("count", (queues, flags), count_text, runs, [read, total, sums[0], self.literal(runs)])
        for level in range(levels):
            self.of_threads("sum", (), sum_text, sizes[level + 1], [
                sums[level], self.literal(sizes[level]), sums[level + 1]])
        self.of_threads("place", (queues, flags, levels), place_text, runs, [
            read, total, self.of_span(order, lanes), self.literal(runs), self.counts(count), *sums])

    def put(self, run: Sequence[Put]) -> None:
        place, lanes, _ = run[0]
        words, case = [self.of_span(place, lanes)], []
        for entry, target in itertools.chain.from_iterable(operation.pairs for operation in run):
            words += (self.of_span(entry, lanes), self.whole(target))
            case.append(OF_SIZE[entry.size])
        self.over(self.of.kernel("put", tuple(case), put_text), lanes, words)

    def inverted(self, operation: Inverted) -> None:
        flags, lanes, result = operation
        name = "clear" if flags is None else "invert"
        self.over(self.of.kernel(name, (name,), move_text), lanes, [
            self.of_span(flags or result, lanes), self.of_span(result, lanes)])

    def copy(self, run: Sequence[Copy]) -> None:
        words = [word for source, target, lanes in run
                 for word in (self.of_span(source, lanes), self.of_span(target, lanes))]
        sizes = tuple(operation.target.size for operation in run)
        self.over(self.of.kernel("copy", sizes, copy_text), run[0].lanes, words)

    def scattered(self, operation: Scattered) -> None:
        words, case = [], []
        for added in operation.groups[0]:
            case.append(added.loop)
            words += (self.of_span(added.index, operation.lanes), self.whole(added.touched), self.literal(added.step),
                      self.literal(added.mask))
            for number, total in zip(added.numbers, added.totals):
                words += (self.of_span(number, operation.lanes), self.whole(total))
        self.over(self.of.kernel("scatter", tuple(case), scatter_text), operation.lanes, words)
