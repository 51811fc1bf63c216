"""Lanes in queues, and entries put into their places: loops that move data and compute nothing, as machine code.

They run on the calling thread, and their order is that of the lanes.
"""

from __future__ import annotations

import ctypes
from array import array
from collections.abc import Sequence

import torch
from torch import Tensor

from torch_radbp.jit.machine import MachineCode, made_once

PARTITION = """\
define void @partition_{scalar}(ptr %numbers, i64 %lanes, ptr %starts, ptr %order) {{
entry:
  %some = icmp sgt i64 %lanes, 0
  br i1 %some, label %lane, label %done
lane:
  %i = phi i64 [ 0, %entry ], [ %next, %lane ]
  %number_at = getelementptr {scalar}, ptr %numbers, i64 %i
  %number = load {scalar}, ptr %number_at
  %queue = {wide}
  %start_at = getelementptr i64, ptr %starts, i64 %queue
  %start = load i64, ptr %start_at, align 8
  %place = getelementptr i32, ptr %order, i64 %start
  %lane32 = trunc i64 %i to i32
  store i32 %lane32, ptr %place, align 4
  %after = add i64 %start, 1
  store i64 %after, ptr %start_at, align 8
  %next = add i64 %i, 1
  %more = icmp slt i64 %next, %lanes
  br i1 %more, label %lane, label %done
done:
  ret void
}}
define void @count_{scalar}(ptr %numbers, i64 %lanes, ptr %counts, ptr %unused) {{
entry:
  %some = icmp sgt i64 %lanes, 0
  br i1 %some, label %lane, label %done
lane:
  %i = phi i64 [ 0, %entry ], [ %next, %lane ]
  %number_at = getelementptr {scalar}, ptr %numbers, i64 %i
  %number = load {scalar}, ptr %number_at
  %queue = {wide}
  %count_at = getelementptr i64, ptr %counts, i64 %queue
  %count = load i64, ptr %count_at, align 8
  %after = add i64 %count, 1
  store i64 %after, ptr %count_at, align 8
  %next = add i64 %i, 1
  %more = icmp slt i64 %next, %lanes
  br i1 %more, label %lane, label %done
done:
  ret void
}}
"""
# Without a branch: a lane that is not chosen is overwritten by the next.
CHOOSE = """\
define i64 @choose(ptr %flags, i64 %lanes, ptr %order) {
entry:
  %some = icmp sgt i64 %lanes, 0
  br i1 %some, label %lane, label %done
lane:
  %i = phi i64 [ 0, %entry ], [ %next, %lane ]
  %k = phi i64 [ 0, %entry ], [ %after, %lane ]
  %place = getelementptr i32, ptr %order, i64 %k
  %lane32 = trunc i64 %i to i32
  store i32 %lane32, ptr %place, align 4
  %flag_at = getelementptr i8, ptr %flags, i64 %i
  %flag = load i8, ptr %flag_at, align 1
  %one = zext i8 %flag to i64
  %after = add i64 %k, %one
  %next = add i64 %i, 1
  %more = icmp slt i64 %next, %lanes
  br i1 %more, label %lane, label %done
done:
  %count = phi i64 [ 0, %entry ], [ %after, %lane ]
  ret i64 %count
}
"""
# Words of a job: where the entries lie, and where they go.
PUT = """\
define void @put_{scalar}(ptr %places, i64 %lanes, ptr %jobs, i64 %count) {{
entry:
  %some = icmp sgt i64 %lanes, 0
  br i1 %some, label %job, label %done
job:
  %k = phi i64 [ 0, %entry ], [ %k_next, %jobs_left ]
  %words = shl i64 %k, 1
  %from_at = getelementptr ptr, ptr %jobs, i64 %words
  %from = load ptr, ptr %from_at, align 8
  %to_at = getelementptr ptr, ptr %from_at, i64 1
  %to = load ptr, ptr %to_at, align 8
  br label %lane
lane:
  %i = phi i64 [ 0, %job ], [ %next, %lane ]
  %place_at = getelementptr i32, ptr %places, i64 %i
  %place32 = load i32, ptr %place_at, align 4
  %place = sext i32 %place32 to i64
  %entry_at = getelementptr {scalar}, ptr %from, i64 %i
  %entry_value = load {scalar}, ptr %entry_at
  %target = getelementptr {scalar}, ptr %to, i64 %place
  store {scalar} %entry_value, ptr %target
  %next = add i64 %i, 1
  %more = icmp slt i64 %next, %lanes
  br i1 %more, label %lane, label %jobs_left
jobs_left:
  %k_next = add i64 %k, 1
  %again = icmp slt i64 %k_next, %count
  br i1 %again, label %job, label %done
done:
  ret void
}}
"""
BITS = (8, 32, 64)  # of an element


class Code:
    """The machine code of the loops."""

    def __init__(self) -> None:
        wide = {bits: f"zext i{bits} %number to i64" for bits in BITS} | {64: "add i64 %number, 0"}
        texts = [(PARTITION + PUT).format(scalar=f"i{bits}", wide=wide[bits]) for bits in BITS]
        module = self.module = MachineCode("\n".join([CHOOSE, *texts]), entry="choose")

        def function(name: str, arguments: str):
            kinds = {"p": ctypes.c_void_p, "n": ctypes.c_int64}
            return ctypes.CFUNCTYPE(None, *(kinds[letter] for letter in arguments))(module.address_of(name))

        self.choose = ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_void_p, ctypes.c_int64, ctypes.c_void_p)(module.address)
        self.count = {bits // 8: function(f"count_i{bits}", "pnpp") for bits in BITS}
        self.partition = {bits // 8: function(f"partition_i{bits}", "pnpp") for bits in BITS}
        self.put = {bits // 8: function(f"put_i{bits}", "pnpn") for bits in BITS}


code = made_once(Code)


def chosen(flags: Tensor) -> Tensor:
    """The lanes, (M,) int32, of which `flags`, (N,) bool, are true."""
    if not flags.is_cpu:
        return flags.nonzero().squeeze(1).to(torch.int32)
    flags = flags.contiguous()
    order = flags.new_empty(flags.numel(), dtype=torch.int32)
    return order[:code().choose(flags.data_ptr(), flags.numel(), order.data_ptr())]


def partition(number: Tensor, queues: int) -> tuple[Tensor, list[int]]:
    """Lanes queue by queue.

    Args:
        number: (N,) bool or integers from 0 to `queues` - 1, which is not checked: the queue of each lane.

    Returns:
        (N,) int32, the lanes of queue 0 in their order, then those of queue 1, ...; and the number of lanes of each queue.
    """
    if not number.is_cpu:
        counts = torch.bincount(number.to(torch.int64), minlength=queues).tolist()
        return number.to(torch.int32).sort(stable=True).indices.to(torch.int32), counts
    number, lanes, size = number.contiguous(), number.numel(), number.element_size()
    order = number.new_empty(lanes, dtype=torch.int32)
    counts = array("q", bytes(8 * queues))
    address = counts.buffer_info()[0]
    code().count[size](number.data_ptr(), lanes, address, None)
    found, first = counts.tolist(), 0
    for queue, count in enumerate(found):
        counts[queue] = first
        first += count
    code().partition[size](number.data_ptr(), lanes, address, order.data_ptr())
    return order, found


def put(targets: Sequence[Tensor], place: Tensor, entries: Sequence[Tensor]) -> None:
    """Overwrites entries of some tensors.

    Args:
        targets: (K,) each, contiguous, written into.
        place: (N,) int32, tells no place twice; that it is inside is not checked.
        entries: (N,) of each target, of its dtype.

    Raises:
        ValueError: if lengths, dtypes or devices do not go together.
    """
    lanes = place.numel()
    for target, entry in zip(targets, entries, strict=True):
        if entry.numel() != lanes or entry.dtype != target.dtype or not target.is_contiguous():
            raise ValueError(f"{lanes} entries of {target.dtype} are put into a contiguous tensor, got {entry.numel()} of "
                             f"{entry.dtype}")
    if not all(tensor.is_cpu for tensor in (place, *targets, *entries)) or place.dtype != torch.int32:
        for target, entry in zip(targets, entries):
            target.index_copy_(0, place.long(), entry)
        return
    place, entries = place.contiguous(), [entry.contiguous() for entry in entries]
    for size in {target.element_size() for target in targets}:
        jobs = array("q")
        for target, entry in zip(targets, entries):
            if target.element_size() == size:
                jobs.extend((entry.data_ptr(), target.data_ptr()))
        code().put[size](place.data_ptr(), lanes, jobs.buffer_info()[0], len(jobs) // 2)
