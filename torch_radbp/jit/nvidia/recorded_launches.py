"""A recording as launches of a GPU: all that was done with lanes, again; the host waits for nothing. See `launches.py`.
"""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from torch_radbp.jit.nvidia.launches import Caster, DeviceRecording, Launches
from torch_radbp.jit.recording.lane_count import LaneCount, most_of
from torch_radbp.jit.recording.lane_operations import LaneSpan, MemoryPlace, Outside, Repeated
from torch_radbp.jit.recording.recording import NotRecordable, Recording
from torch_radbp.jit.recording.results import WHOLE, RecordedInputs, RecordedResults, ResultPlace

MOST_ROOMS = 64  # for which the launches of a recording are kept
BITS = 6  # bits of a number of lanes that count, so that there are few rooms


def rounded_up(lanes: int) -> int:
    """The lanes that there is room for where there may be so many: a little more, at least whole lines of memory."""
    unit = max(64, 1 << max(0, lanes.bit_length() - BITS))
    return -(-lanes // unit) * unit


class RecordedLaunches(RecordedResults):
    """What was recorded, to be done again on a GPU; args as for `recorded.Recorded`.

    Args:
        gpu: the target.
    """

    def __init__(self, gpu, recording: Recording, given: Sequence[Tensor | int], results: Any):
        if any(isinstance(operation, Outside) for operation in recording.operations):
            raise NotRecordable("what is done outside is done by the host between launches")
        if any(isinstance(operation, Repeated) for operation in recording.operations):
            raise NotRecordable("the host decides whether something is repeated")
        super().__init__(recording, given, results)
        self.left = recording.left
        self.gpu, self.device = gpu, recording.reserve.device
        self.of = DeviceRecording(gpu.kernel, recording.operations, recording.made, self.layout, len(given),
                                  1 + recording.given_counts)
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
        lanes = rounded_up(most)
        launches = self.launches.get(lanes)
        if launches is None:
            if len(self.launches) >= MOST_ROOMS:
                self.launches.clear()
            launches = self.launches.setdefault(lanes, Launches(self.of, lanes))
        return launches

    def bytes(self, size: int) -> Tensor:
        """Memory of the device."""
        return torch.empty(size, dtype=torch.uint8, device=self.device)
