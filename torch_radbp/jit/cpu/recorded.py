"""A recording as machine code, which runs again for other numbers of lanes."""

from __future__ import annotations

import ctypes
import itertools
from array import array
from collections.abc import Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torch_radbp.jit.cpu import kernel_code
from torch_radbp.jit.cpu.board import Board
from torch_radbp.jit.cpu.large_pages import block_of
from torch_radbp.jit.cpu.machine import MachineCode, cached_code
from torch_radbp.jit.cpu.recorded_text import Writer
from torch_radbp.jit.recording.lane_operations import MemoryPlace, Outside
from torch_radbp.jit.recording.recording import Recording
from torch_radbp.jit.recording.results import WHOLE, RecordedInputs, RecordedResults, ResultGroup

SHARES = 64  # of the lanes that are enough for better code: so often loops are told of lanes, which takes time
RECORDED = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 6, ctypes.c_int64, ctypes.c_int64)


class Memory(NamedTuple):
    """The memory that one run of a recording reads and writes."""

    given: Sequence[Tensor | int]
    kept: list[Tensor]  # for the results, one tensor for each group
    places: array  # addresses of these
    room: Tensor  # bytes for temporaries
    row: int  # entries per temporary


class Recorded(RecordedResults):
    """A recording compiled into one function of machine code, which the processor runs. Args as for `RecordedResults`."""

    def __init__(self, recording: Recording, given: Sequence[Tensor | int], results: Any):
        super().__init__(recording, given, results)
        writer = Writer(recording, self.layout, len(given))
        text = writer.text()
        self.code: MachineCode = cached_code(text, entry="recorded0", optimized=False)
        self.outside = [operation for operation in recording.operations if isinstance(operation, Outside)]
        self.parts = [RECORDED(self.code.address_of(f"recorded{number}")) for number in range(1 + len(self.outside))]
        self.dtypes = [made.dtype for made in recording.made]
        self.called = writer.functions  # so that they stay where they are
        self.functions = array("q", [called if isinstance(called, int) else called.address for called in self.called])
        self.improving = [place for place, called in enumerate(self.called) if not isinstance(called, int)]
        self.lanes = 0  # of runs that these loops do not know of yet

    def __call__(self, given: RecordedInputs, others: RecordedInputs, lanes: int, board: Board, known: Sequence[int] = (),
                 contexts: Sequence[Any] = ()) -> tuple[Any, array]:
        """Runs the recording: returns its results, and all counts.

        Args:
            given, others: one after the other, as for the constructor; no result is one of the others.
            lanes: how many, at least 1.
            board: of the helpers; it is open afterwards.
            known: the counts that the function is told.
            contexts: of what is done outside.
        """
        self.takes(lanes)
        row = -(-lanes // 64) * 64
        addresses = given.addresses + others.addresses + given.lengths + others.lengths
        kept = [self.rows_of(group, row) for group in self.layout.groups]
        room = block_of((max(1, self.layout.bytes * row),), torch.uint8)
        places, counts = array("q", [block.data_ptr() for block in kept]), array("q", [0, lanes, *known])
        counts.extend([0] * (self.counts - len(counts)))
        memory = Memory((*given.items, *others.items), kept, places, room, row)
        for part, outside in zip(self.parts, [*self.outside, None]):
            board.open()
            part(addresses.buffer_info()[0], places.buffer_info()[0], room.data_ptr(), counts.buffer_info()[0],
                 self.functions.buffer_info()[0], board.address, lanes, row)
            if outside is not None:
                board.close()
                self.do(outside, contexts, memory, counts)
        lengths = [counts[last] - counts[first] for _, (first, last), *_ in self.layout.groups]
        rows = [(block if group.handed else block.narrow(1, 0, length)).unbind(0)
                for block, group, length in zip(kept, self.layout.groups, lengths)]
        # The places GIVEN and EMPTY.
        rows += [given.items, [torch.empty(0, dtype=dtype, device="cpu") for dtype in self.empty]]
        results = [rows[group][row] if count == WHOLE else rows[group][row][:counts[count]]
                   for group, row, count in self.found]
        return self.assemble(results), counts

    def takes(self, lanes: int) -> None:
        """Counts the lanes of a run; now and then reports them to the recorded loops, and takes over their better code."""
        if not self.improving:
            return
        self.lanes += max(lanes, kernel_code.LEAST)
        if self.lanes < kernel_code.ENOUGH // SHARES:
            return
        lanes, self.lanes, going_on = self.lanes, 0, []
        for place in self.improving:
            if self.called[place].takes(lanes):
                going_on.append(place)
            self.functions[place] = self.called[place].address
        self.improving = going_on

    @staticmethod
    def rows_of(group: ResultGroup, entries: int) -> Tensor:
        """A tensor for the results of a group, (tensors, entries); empty if work outside of the code makes them."""
        if group.handed:
            return torch.empty((len(group.tensors), 0), dtype=group.dtype, device="cpu")
        return block_of((len(group.tensors), entries), group.dtype)

    def do(self, outside: Outside, contexts: Sequence[Any], memory: Memory, counts: array) -> None:
        """Runs work outside of machine code, such as a network, and puts its results into memory; not without lanes."""
        lanes = [counts[part.lanes.last] - counts[part.lanes.first] for part in outside.parts]
        if not any(lanes):
            return
        given = [[self.tensor(place, memory, counts, number) for place in part.inputs]
                 for part, number in zip(outside.parts, lanes)]
        found = outside.work(contexts[outside.context], given)
        for place, result in zip(outside.outputs, itertools.chain.from_iterable(found), strict=True):
            group, _ = self.layout.rows[place.tensor]
            memory.kept[group] = result.contiguous().unsqueeze(0)
            memory.places[group] = memory.kept[group].data_ptr()

    def tensor(self, place: MemoryPlace, memory: Memory, counts: array, lanes: int) -> Tensor:
        """(lanes,) the tensor at a place in memory."""
        first = counts[place.first]
        if not place.made:
            return memory.given[place.tensor][first:first + lanes]
        if place.tensor in self.layout.rows:
            group, row = self.layout.rows[place.tensor]
            return memory.kept[group][row, first:first + lanes]
        start = self.layout.at[place.tensor] * memory.row + first * place.size
        return memory.room[start:start + lanes * place.size].view(self.dtypes[place.tensor])
