"""A recording as kernels: all that was done with lanes, as launches one after the other, for which the host waits nowhere.

Numbers of lanes that are found on the way stay on the device: each kernel is launched for as many lanes as there may be, and
reads which of them there are. So a tensor has room for all lanes, and what belongs to the lanes between two counts stands in
it from the first count on. Where everything lies is known before the first launch; the words that kernels are given are sums
of an address and a distance, and are computed together.
"""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

import torch
from torch import Tensor

from torch_radbp.jit.lane_count import LaneCount, most_of
from torch_radbp.jit.lane_operations import (
    Chosen,
    Copy,
    Inverted,
    LaneSpan,
    MemoryPlace,
    Outside,
    Partition,
    Put,
    RecordedLoop,
    Scattered,
)
from torch_radbp.jit.nvptx import BLOCK
from torch_radbp.jit.nvptx_lanes import counts_text, move_text, put_text, scatter_text
from torch_radbp.jit.nvptx_order import GROUP, MOST_QUEUES, RUN, count_text, place_text, sum_text
from torch_radbp.jit.recorded import WHOLE, RecordedInputs, RecordedResults, ResultPlace
from torch_radbp.jit.recording import NotRecordable, Recording

OF_SIZE = {1: torch.bool, 4: torch.int32, 8: torch.int64}  # entries that are moved, by their bytes
BLOCKS = "nothing", "counts", "scratch", "room"  # of memory, that words may point into; behind these come results


MOST_ROOMS = 64  # for which the launches of a recording are kept
BITS = 6  # bits of a number of lanes that count, so that there are few rooms


def room(lanes: int) -> int:
    """The lanes that there is room for where there may be so many: a little more, at least whole lines of memory."""
    unit = max(64, 1 << max(0, lanes.bit_length() - BITS))
    return -(-lanes // unit) * unit


class RayQuery(NamedTuple):
    """Rays that a caster of the device casts: `caster.launch(kernel, ...)`, see `Launches.launch`."""

    kernel: Any

    @property
    def address(self) -> int:
        raise NotRecordable("rays are cast by the device")


class Caster(Protocol):
    """What casts rays on a device."""

    def launch(self, kernel: Any, lanes: int, last: int, addresses: Sequence[int]) -> None:
        """Casts a ray for each lane, and does not wait for it.

        Args:
            kernel: that was recorded.
            lanes: as many as there may be.
            last: the address of their number, int64.
            addresses: of what the kernel reads and writes.
        """


class Word(NamedTuple):
    """A word that a kernel is given: an address, and a distance from there."""

    block: int  # whose address it is; 0: none
    distance: int


class Launch(NamedTuple):
    """A kernel that is launched."""

    kernel: Any  # a `LoadedKernel`, or a `RayQuery`
    blocks: int
    first: int  # of its words
    last: int


class Launches:
    """The launches of a recording for so many lanes.

    Args:
        of: the recording.
        lanes: as many as there may be, from `room`; so many entries is each tensor long.
    """

    def __init__(self, of: RecordedLaunches, lanes: int):
        self.of, self.lanes = of, lanes
        self.sequence: list[Launch] = []
        self.words: list[Word] = []
        self.scratch = 0  # bytes
        self.add(of.gpu.kernel("counts", (of.known,), counts_text), 1, [
            self.literal(1), *[Word(0, 0)] * 2, self.counts(0),
            *[Word(of.first_count + place, 0) for place in range(2 * of.known)]])
        write = {RecordedLoop: self.loop, Partition: self.partition, Chosen: self.chosen, Put: self.put,
                 Inverted: self.inverted, Copy: self.copy, Scattered: self.scattered}
        for operation in of.operations:
            write[type(operation)](operation)
        self.blocks = torch.tensor([word.block for word in self.words], dtype=torch.int64, device="cpu")
        self.distances = torch.tensor([word.distance for word in self.words], dtype=torch.int64, device="cpu")

    # -- Words ----------------------------------------------------------------------------------------------------------

    @staticmethod
    def literal(number: int) -> Word:
        return Word(0, number)

    @staticmethod
    def counts(number: int) -> Word:
        """Where a count stands."""
        return Word(BLOCKS.index("counts"), 8 * number)

    def place(self, place: MemoryPlace) -> Word:
        """Where a tensor begins."""
        if not place.made:
            return Word(self.of.first_given + place.tensor, 0)
        layout = self.of.layout
        if place.tensor in layout.rows:
            group, row = layout.rows[place.tensor]
            return Word(len(BLOCKS) + group, row * self.lanes * place.size)
        return Word(BLOCKS.index("room"), layout.at[place.tensor] * self.lanes)

    def of_span(self, place: MemoryPlace, lanes: LaneSpan) -> Word:
        """Where a tensor begins that has an entry for each of some lanes, which are those from their first on."""
        first = self.first_of(place)
        if first != lanes.first:
            raise NotRecordable("entries of lanes do not stand where the lanes do")
        return self.place(place)

    def whole(self, place: MemoryPlace) -> Word:
        """Where a tensor lies that is read at indices."""
        if self.first_of(place):
            raise NotRecordable("a table begins where only the device knows")
        return self.place(place)

    def first_of(self, place: MemoryPlace) -> int:
        """The count at which the entries of a place begin in the room for all lanes."""
        before = self.of.made[place.tensor].lanes.first if place.made else 0
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
        self.add(self.of.gpu.kernel(name, case, text), threads, [self.literal(threads), *[Word(0, 0)] * 2, *words])

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
        """Adds what puts lanes into queues, of which `count` is the first number that is found."""
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

    def put(self, operation: Put) -> None:
        place, lanes, pairs = operation
        words = [self.of_span(place, lanes)]
        for entry, target in pairs:
            words += (self.of_span(entry, lanes), self.whole(target))
        case = (OF_SIZE[pairs[0][0].size],) * len(pairs)
        self.over(self.of.gpu.kernel("put", case, put_text), lanes, words)

    def moved(self, name: str, size: int, source: MemoryPlace, target: MemoryPlace, lanes: LaneSpan) -> None:
        self.over(self.of.gpu.kernel(name, (name, size), move_text), lanes, [
            self.of_span(source, lanes), self.of_span(target, lanes)])

    def inverted(self, operation: Inverted) -> None:
        flags, lanes, result = operation
        self.moved("clear" if flags is None else "invert", 1, flags or result, result, lanes)

    def copy(self, operation: Copy) -> None:
        self.moved("copy", operation.target.size, operation.source, operation.target, operation.lanes)

    def scattered(self, operation: Scattered) -> None:
        words, case = [], []
        for added in operation.groups[0]:
            case.append(added.loop)
            words += (self.of_span(added.index, operation.lanes), self.whole(added.touched), self.literal(added.step),
                      self.literal(added.mask))
            for number, total in zip(added.numbers, added.totals):
                words += (self.of_span(number, operation.lanes), self.whole(total))
        self.over(self.of.gpu.kernel("scatter", tuple(case), scatter_text), operation.lanes, words)


class RecordedLaunches(RecordedResults):
    """What was recorded, to be done again on a GPU; args as for `recorded.Recorded`.

    Args:
        gpu: the target.
    """

    def __init__(self, gpu, recording: Recording, given: Sequence[Tensor | int], results: Any):
        self.gpu, self.device = gpu, recording.reserve.device
        self.operations, self.made = recording.operations, recording.made
        if any(isinstance(operation, Outside) for operation in self.operations):
            raise NotRecordable("what is done outside is done by the host between launches")
        super().__init__(recording, given, results)
        self.known = 1 + recording.given_counts
        # The addresses that words begin with: blocks of memory, results, what is given, its lengths, counts that are known.
        self.first_given = len(BLOCKS) + len(self.layout.groups)
        self.first_length = self.first_given + len(given)
        self.first_count = self.first_length + len(given)
        self.launches: dict[int, Launches] = {}
        self.prepared(1)  # raises what there is to raise

    def where(self, place: MemoryPlace | None, lanes: LaneSpan, dtype: torch.dtype) -> ResultPlace:
        if lanes.first:
            raise NotRecordable("a result begins where only the device knows")
        return super().where(place, lanes, dtype)

    def __call__(self, given: RecordedInputs, others: RecordedInputs, lanes: int | LaneCount,
                 known: Sequence[int | LaneCount], caster: Caster | None,
                 waits: bool) -> tuple[Any, Sequence[int | LaneCount]]:
        """The results, and all counts.

        Args:
            given, others: one after the other, as for the constructor; no result is one of the others.
            lanes: how many, at most at least 1.
            known: the counts that the function is told.
            caster: of rays.
            waits: whether the host waits for the counts: then results are as long as these say. Else they have room for all
                lanes, and counts stay on the device.
        """
        most = most_of(lanes)
        launches = self.prepared(most)
        kept = [self.bytes(len(group.tensors) * launches.lanes * group.dtype.itemsize).view(group.dtype).view(
            -1, launches.lanes) for group in self.layout.groups]
        counts, scratch, rest = (self.bytes(max(1, size)) for size in (
            8 * self.counts, launches.scratch, self.layout.bytes * launches.lanes))
        bases = array("q", [0, *[block.data_ptr() for block in (counts, scratch, rest, *kept)]])
        bases += given.addresses + others.addresses + given.lengths + others.lengths
        for count in (lanes, *known):
            bases.extend((count.address, 0) if isinstance(count, LaneCount) else (0, count))
        words = torch.frombuffer(bases, dtype=torch.int64).index_select(0, launches.blocks).add_(launches.distances)
        self.gpu.launch_all(launches.sequence, words, launches.lanes, caster)
        counts = counts.view(torch.int64)
        if waits:
            counts = counts.tolist()
            lengths = [counts[group.lanes.last] for group in self.layout.groups]
        else:
            counts = [LaneCount(counts, number, most) for number in range(self.counts)]
            lengths = [most] * len(kept)
        rows = [block.narrow(1, 0, length).unbind(0) for block, length in zip(kept, lengths)]
        rows += [given.items, [torch.empty(0, dtype=dtype, device=self.device) for dtype in self.empty]]
        results = [rows[group][row][:counts[count]] if waits and count != WHOLE else rows[group][row]
                   for group, row, count in self.found]
        return self.assemble(results), counts

    def prepared(self, most: int) -> Launches:
        """The launches for so many lanes at most."""
        lanes = room(most)
        launches = self.launches.get(lanes)
        if launches is None:
            if len(self.launches) >= MOST_ROOMS:
                self.launches.clear()
            launches = self.launches.setdefault(lanes, Launches(self, lanes))
        return launches

    def bytes(self, size: int) -> Tensor:
        """Memory of the device."""
        return torch.empty(size, dtype=torch.uint8, device=self.device)
