"""A recording as launches of a GPU: all that was done with lanes, again; the host waits for nothing. See `launches.py`.
"""

from __future__ import annotations

import itertools
from array import array
from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torch_radbp.jit.nvidia.launches import BLOCKS, Caster, DeviceRecording, Launches
from torch_radbp.jit.recording.lane_count import LaneCount, most_of
from torch_radbp.jit.recording.lane_operations import LaneSpan, MemoryPlace, Outside, Repeated
from torch_radbp.jit.recording.recording import NotRecordable, Recording
from torch_radbp.jit.recording.results import WHOLE, RecordedInputs, RecordedResults, ResultPlace

MOST_ROOMS = 64  # for which the launches of a recording are kept
BITS = 6  # bits of a number of lanes that count, so that there are few rooms


def rounded_up(lanes: int) -> int:
    """A number of lanes rounded up to one of few sizes, by a little, for memory in which tensors begin at whole lines."""
    unit = max(64, 1 << max(0, lanes.bit_length() - BITS))
    return -(-lanes // unit) * unit


class Room(NamedTuple):
    """The memory that launches read and write."""

    given: Sequence[Tensor | int]
    kept: Sequence[Tensor]  # of each group of results
    rest: Tensor  # bytes
    counts: Tensor  # int64
    lanes: int  # entries of each tensor


class RecordedLaunches(RecordedResults):
    """What was recorded, to be done again on a GPU; args as for `recorded.Recorded`.

    Args:
        gpu: the target.
    """

    def __init__(self, gpu, recording: Recording, given: Sequence[Tensor | int], results: Any):
        self.in_place = recording.in_place > 0
        if any(isinstance(operation, Repeated) for operation in recording.operations):
            raise NotRecordable("the host decides whether something is repeated")
        super().__init__(recording, given, results)
        self.left = recording.left
        self.gpu, self.device = gpu, recording.reserve.device
        spans = [recording.spans.get(item.numel()) if number < recording.in_place and isinstance(item, Tensor) else None
                 for number, item in enumerate(given)]
        self.of = DeviceRecording(gpu.kernel, recording.operations, recording.made, self.layout, spans,
                                  1 + recording.given_counts)
        self.launches: dict[int, Launches] = {}
        self.prepared(1)  # raises what there is to raise

    def where(self, place: MemoryPlace | None, lanes: LaneSpan, dtype: torch.dtype) -> ResultPlace:
        handed = place is not None and place.made and self.layout.groups[self.layout.rows[place.tensor][0]].handed
        if lanes.first and not (handed or self.in_place):
            raise NotRecordable("a result begins where only the device knows")
        return super().where(place, lanes, dtype)

    def __call__(self, given: RecordedInputs, others: RecordedInputs, lanes: int | LaneCount,
                 known: Sequence[int | LaneCount], caster: Caster | None, waits: bool,
                 contexts: Sequence[Any] = ()) -> tuple[Any, Sequence[int | LaneCount]]:
        """The results, and all counts.

        Args:
            given, others: one after the other, as for the constructor; no result is one of the others.
            lanes: how many, at most at least 1.
            known: the counts that the function is told.
            caster: of rays.
            waits: whether the host waits for the counts: then results are as long as these say. Else they have room for all
                lanes, in which those of a part of the lanes stand where this does, and counts stay on the device.
            contexts: of what is done outside.
        """
        most = most_of(lanes)
        launches = self.prepared(most)
        comes_again = self.gpu.comes_again(launches.lanes)
        room = partial(self.gpu.room, device=self.device, comes_again=comes_again)
        kept = [room(0 if group.handed else len(group.tensors) * launches.lanes * group.dtype.itemsize).view(
            group.dtype).view(-1, launches.lanes) for group in self.layout.groups]
        counts, scratch, rest = (room(max(1, size)) for size in (
            8 * self.counts, launches.scratch, self.layout.bytes * launches.lanes))
        bases = array("q", [0, *[block.data_ptr() for block in (counts, scratch, rest, *kept)]])
        bases += given.addresses + others.addresses + given.lengths + others.lengths
        for count in (lanes, *known):
            bases.extend((count.address, 0) if isinstance(count, LaneCount) else (0, count))
        counts = counts.view(torch.int64)
        for part in launches.parts:
            blocks, distances = launches.blocks[part.words], launches.distances[part.words]
            words = torch.frombuffer(bases, dtype=torch.int64).index_select(0, blocks).add_(distances)
            self.gpu.launch_all(part, words, launches.lanes, caster, comes_again)
            if part.outside is not None:
                own = Room((*given.items, *others.items), kept, rest, counts, launches.lanes)
                for group, found in self.do(part.outside, contexts, own):
                    kept[group], bases[len(BLOCKS) + group] = found[None], found.data_ptr()
        if waits:
            counts = counts.tolist()
            borders = [(counts[group.lanes.first], counts[group.lanes.last]) for group in self.layout.groups]
        else:
            counts = [LaneCount(counts, number, most) for number in range(self.counts)]
            borders = [(0, most)] * len(kept)
        rows = [block[:, first:last].unbind(0) for block, (first, last) in zip(kept, borders)]
        rows += [given.items, [torch.empty(0, dtype=dtype, device=self.device) for dtype in self.empty]]
        results = [rows[group][row][:counts[count]] if waits and count != WHOLE else rows[group][row]
                   for group, row, count in self.found]
        return self.assemble(results), counts

    def do(self, outside: Outside, contexts: Sequence[Any], room: Room) -> Iterator[tuple[int, Tensor]]:
        """Runs work outside of kernels, such as a network, on tensors with room for all lanes; surplus lanes get row -1.

        Yields:
            The groups of results, each with what was found.
        """
        lanes = torch.arange(room.lanes, device=self.device)
        given = []
        for part in outside.parts:
            row, *more = (self.tensor(place, room) for place in part.inputs)
            first, last = room.counts[part.lanes.first], room.counts[part.lanes.last]
            given.append([torch.where((lanes >= first) & (lanes < last), row, -1), *more])
        found = outside.work(contexts[outside.context], given)
        for place, result in zip(outside.outputs, itertools.chain.from_iterable(found), strict=True):
            yield self.layout.rows[place.tensor][0], result.contiguous()

    def tensor(self, place: MemoryPlace, room: Room) -> Tensor:
        """The tensor at a place in memory, with entries for all lanes."""
        if not place.made:
            return room.given[place.tensor][:room.lanes]
        if place.tensor in self.layout.rows:
            group, row = self.layout.rows[place.tensor]
            return room.kept[group][row]
        start = self.layout.at[place.tensor] * room.lanes
        return room.rest[start:start + room.lanes * place.size].view(self.of.made[place.tensor].dtype)

    def prepared(self, most: int) -> Launches:
        """The launches with room for `most` lanes; made once for each size of that room."""
        lanes = rounded_up(most)
        launches = self.launches.get(lanes)
        if launches is None:
            if len(self.launches) >= MOST_ROOMS:
                self.launches.clear()
            launches = self.launches.setdefault(lanes, Launches(self.of, lanes))
        return launches
