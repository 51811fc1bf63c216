"""Runs consecutive recordings tile by tile: each thread takes some lanes through all of them.

What one recording hands to the next then stays in the caches of a processor, and threads need not meet in between. A thread
has memory of its own: what recordings hand on, of the last and of this one in turn, the room that each has for itself, and
the arrays that its code reads.
"""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.jit.cpu.board import run_loop
from torch_radbp.jit.cpu.large_pages import block_of
from torch_radbp.jit.cpu.machine import MachineCode, cached_code
from torch_radbp.jit.cpu.recorded import Recorded
from torch_radbp.jit.lane.loops import WRITE_JOB
from torch_radbp.jit.recording.recording import NotRecordable
from torch_radbp.jit.recording.results import WHOLE, RecordedInputs
from torch_radbp.threads.made_once import made_once
from torch_radbp.threads.team import run_lanes, threads

TILE = 4096  # lanes
# The words of an array that describes a recording, in order, as the code reads them.
FIELDS = ("code", "functions", "template", "words", "links", "handed", "offsets", "groups", "spans", "casts", "count")
STEP = "\n".join(f"  %{name}_at = getelementptr i64, ptr %step, i64 {place}\n  %{name} = load i64, ptr %{name}_at, align 8"
                 for place, name in enumerate(FIELDS))
# The inputs of the loop, in order.
INPUTS = ("steps", "depth", "memory", "bytes", "slot", "row", "area", "room", "given", "kept", "counts", "rays")
READ_INPUTS = "\n".join(
    f"  %{name}_at = getelementptr i64, ptr %inputs, i64 {place}\n  %{name} = load i64, ptr %{name}_at, align 8"
    for place, name in enumerate(INPUTS))
TEXT = f"""\
define void @alone(ptr %board, ptr %body, i64 %lanes, i64 %part, ptr %inputs, ptr %outputs) {{
  %job = alloca [5 x i64], align 8
  %some = icmp sgt i64 %lanes, 0
  br i1 %some, label %work, label %done
work:
{WRITE_JOB}  call void %body(ptr %job)
  br label %done
done:
  ret void
}}

define void @lanes_of_job(ptr %job) {{
entry:
  %lanes = load i64, ptr %job, align 8
  %size_at = getelementptr i64, ptr %job, i64 1
  %size = load i64, ptr %size_at, align 8
  %next_at = getelementptr i64, ptr %job, i64 2
  %given_at = getelementptr i64, ptr %job, i64 3
  %inputs = load ptr, ptr %given_at, align 8
  %memory_at = getelementptr i64, ptr %inputs, i64 {INPUTS.index("memory")}
  %memories = load ptr, ptr %memory_at, align 8
  %bytes_at = getelementptr i64, ptr %inputs, i64 {INPUTS.index("bytes")}
  %bytes = load i64, ptr %bytes_at, align 8
  %slot_at = getelementptr i64, ptr %inputs, i64 {INPUTS.index("slot")}
  %slot = atomicrmw add ptr %slot_at, i64 1 monotonic
  %before = mul i64 %slot, %bytes
  %memory = getelementptr i8, ptr %memories, i64 %before
  br label %take
take:
  %first = atomicrmw add ptr %next_at, i64 %size monotonic
  %left = icmp slt i64 %first, %lanes
  br i1 %left, label %work, label %done
work:
  %rest = sub i64 %lanes, %first
  %count = call i64 @llvm.smin.i64(i64 %rest, i64 %size)
  call void @tile(i64 %first, i64 %count, ptr %inputs, ptr %memory)
  br label %take
done:
  ret void
}}

define internal void @tile(i64 %first, i64 %lanes, ptr %inputs, ptr %own) {{
entry:
{READ_INPUTS}
  %all_steps = inttoptr i64 %steps to ptr
  %own_room = getelementptr i8, ptr %own, i64 %room
  %own_given = getelementptr i8, ptr %own, i64 %given
  %own_kept = getelementptr i8, ptr %own, i64 %kept
  %own_counts = getelementptr i8, ptr %own, i64 %counts
  br label %recording
recording:
  %number = phi i64 [ 0, %entry ], [ %number.next, %go_on ]
  %reaching = phi i64 [ %lanes, %entry ], [ %going_on, %go_on ]
  %cast_before = phi i64 [ 0, %entry ], [ %cast, %go_on ]
  %step_at = getelementptr ptr, ptr %all_steps, i64 %number
  %step = load ptr, ptr %step_at, align 8
{STEP}
  %function = inttoptr i64 %code to ptr
  %called = inttoptr i64 %functions to ptr
  %from = inttoptr i64 %template to ptr
  %size = mul i64 %words, 8
  call void @llvm.memcpy.p0.p0.i64(ptr %own_given, ptr %from, i64 %size, i1 false)
  %odd = and i64 %number, 1
  %here_at = mul i64 %odd, %area
  %there_at = sub i64 %area, %here_at
  %here = getelementptr i8, ptr %own, i64 %here_at
  %there = getelementptr i8, ptr %own, i64 %there_at
  %begins = icmp eq i64 %number, 0
  %some_links = icmp sgt i64 %handed, 0
  br i1 %some_links, label %link, label %places
link:
  %l = phi i64 [ 0, %recording ], [ %l.next, %link ]
  %link_list = inttoptr i64 %links to ptr
  %twice = mul i64 %l, 2
  %place_at = getelementptr i64, ptr %link_list, i64 %twice
  %place = load i64, ptr %place_at, align 8
  %distance_at = getelementptr i64, ptr %place_at, i64 1
  %distance = load i64, ptr %distance_at, align 8
  %word = getelementptr ptr, ptr %own_given, i64 %place
  %start = load ptr, ptr %word, align 8
  %lanes_before = mul i64 %first, %distance
  %of_first = getelementptr i8, ptr %start, i64 %lanes_before
  %of_others = getelementptr i8, ptr %there, i64 %distance
  %found = select i1 %begins, ptr %of_first, ptr %of_others
  store ptr %found, ptr %word, align 8
  %l.next = add i64 %l, 1
  %more_links = icmp slt i64 %l.next, %handed
  br i1 %more_links, label %link, label %places
places:
  %some_groups = icmp sgt i64 %groups, 0
  br i1 %some_groups, label %group, label %run
group:
  %g = phi i64 [ 0, %places ], [ %g.next, %group ]
  %offset_list = inttoptr i64 %offsets to ptr
  %offset_at = getelementptr i64, ptr %offset_list, i64 %g
  %offset = load i64, ptr %offset_at, align 8
  %group_at = getelementptr ptr, ptr %own_kept, i64 %g
  %rows = getelementptr i8, ptr %here, i64 %offset
  store ptr %rows, ptr %group_at, align 8
  %g.next = add i64 %g, 1
  %more_groups = icmp slt i64 %g.next, %groups
  br i1 %more_groups, label %group, label %run
run:
  store i64 0, ptr %own_counts, align 8
  %all_at = getelementptr i64, ptr %own_counts, i64 1
  store i64 %reaching, ptr %all_at, align 8
  call void %function(ptr %own_given, ptr %own_kept, ptr %own_room, ptr %own_counts, ptr %called, ptr null, i64 %reaching,
                      i64 %row)
  %some_casts = icmp sgt i64 %casts, 0
  br i1 %some_casts, label %cast_one, label %next
cast_one:
  %c = phi i64 [ 0, %run ], [ %c.next, %cast_one ]
  %sum = phi i64 [ %cast_before, %run ], [ %sum.next, %cast_one ]
  %span_list = inttoptr i64 %spans to ptr
  %c_twice = mul i64 %c, 2
  %from_at = getelementptr i64, ptr %span_list, i64 %c_twice
  %from_count = load i64, ptr %from_at, align 8
  %to_at = getelementptr i64, ptr %from_at, i64 1
  %to_count = load i64, ptr %to_at, align 8
  %from_number_at = getelementptr i64, ptr %own_counts, i64 %from_count
  %from_number = load i64, ptr %from_number_at, align 8
  %to_number_at = getelementptr i64, ptr %own_counts, i64 %to_count
  %to_number = load i64, ptr %to_number_at, align 8
  %some_rays = sub i64 %to_number, %from_number
  %sum.next = add i64 %sum, %some_rays
  %c.next = add i64 %c, 1
  %more_casts = icmp slt i64 %c.next, %casts
  br i1 %more_casts, label %cast_one, label %next
next:
  %cast = phi i64 [ %cast_before, %run ], [ %sum.next, %cast_one ]
  %number.next = add i64 %number, 1
  %deeper = icmp slt i64 %number.next, %depth
  br i1 %deeper, label %see, label %done
see:
  %going_on_at = getelementptr i64, ptr %own_counts, i64 %count
  %going_on = load i64, ptr %going_on_at, align 8
  %somebody = icmp sgt i64 %going_on, 0
  br i1 %somebody, label %go_on, label %done
go_on:
  br label %recording
done:
  %before = atomicrmw add ptr %rays_at, i64 %cast monotonic
  ret void
}}
declare i64 @llvm.smin.i64(i64, i64)
declare void @llvm.memcpy.p0.p0.i64(ptr, ptr, i64, i1)
"""


class Handed(NamedTuple):
    """The memory layout of a recording's results, as the next recording reads them."""

    offsets: array  # offsets of the groups of results, in bytes
    results: array  # for each result its index, and its offset in bytes
    bytes: int  # total size
    count: int  # index of the count of lanes that go on: the entries of the last result; -1: there is none


class TileStep(NamedTuple):
    """A recording with its inputs, to be run for a tile, some consecutive lanes."""

    recorded: Recorded
    handed: Handed
    given: RecordedInputs  # first the results of the recording before, in order; of the first recording, lanes
    lanes: int  # how many of the inputs these are


@made_once
def code() -> MachineCode:
    """The machine code of this module's LLVM IR, `TEXT`."""
    return cached_code(TEXT)


def handed(recorded: Recorded) -> Handed:
    """The memory layout of a recording's results.

    Raises:
        NotRecordable: if a result is an input of the recording, or made outside of machine code.
    """
    offsets, results, size = array("q"), array("q"), 0
    for group in recorded.layout.groups:
        if group.handed:
            raise NotRecordable("what is done outside is done for all lanes")
        offsets.append(size)
        size += len(group.tensors) * TILE * group.dtype.itemsize
    count = -1
    for number, (group, row, last) in enumerate(recorded.found):
        if group < 0:
            raise NotRecordable("a result is not made by a loop")
        own = recorded.layout.groups[group]
        results.extend([number, offsets[group] + row * TILE * own.dtype.itemsize])
        count = own.lanes.last if last == WHOLE else last
    return Handed(offsets, results, size, count)


def run_in_tiles(steps: Sequence[TileStep], lanes: int) -> int:
    """Runs consecutive recordings tile by tile, while lanes go on; returns the number of rays cast.

    Args:
        steps: the recordings. The results of each are the first inputs of the next; the last result tells which lanes go on.
        lanes: the number of lanes of the first, at least 1.
    """
    alone, shared = code().address_of("alone"), run_loop()
    alive: list[array] = []

    def address(words: array) -> int:
        alive.append(words)
        return words.buffer_info()[0]

    described, links = array("q"), array("q")
    for number, (recorded, own, given, count) in enumerate(steps):
        if number == 0:
            for place, item in enumerate(given.items[:count]):
                links.extend([place, item.element_size()])
        recorded.takes(lanes)
        functions = array("q", [alone if function == shared else function for function in recorded.functions])
        template = given.addresses + given.lengths
        spans = array("q", [border for span in recorded.rays for border in span])
        described.append(address(array("q", [
            recorded.code.address, address(functions), address(template), len(template), address(links), len(links) // 2,
            address(own.offsets), len(own.offsets), address(spans), len(recorded.rays), own.count])))
        links = own.results
    area = max(step.handed.bytes for step in steps)
    room, words = 2 * area, max(2 * len(step.given.items) for step in steps)
    given_at = room + max(1, max(step.recorded.layout.bytes for step in steps)) * TILE
    kept_at = given_at + 8 * words
    counts_at = kept_at + 8 * max(len(step.handed.offsets) for step in steps)
    size = -(-(counts_at + 8 * max(step.recorded.counts for step in steps)) // 4096) * 4096
    memory: Tensor = block_of((threads() * size,), torch.uint8)
    inputs = array("q", [address(described), len(steps), memory.data_ptr(), size, 0, TILE, area, room, given_at, kept_at,
                         counts_at, 0])
    run_lanes(code().address, lanes, inputs, array("q"), TILE)
    return inputs[INPUTS.index("rays")]
