"""`order.in_order` on the CPU: lanes are partitioned by one number, and each part sorted by another."""

from __future__ import annotations

import ctypes

import torch
from torch import Tensor

from torch_radbp.jit.cpu.cpu_order import partition_on_cpu
from torch_radbp.jit.cpu.machine import cached_code
from torch_radbp.threads.made_once import made_once

# Each run of lanes, one after the other, in the order of its keys: a key moves down past those that are greater. And the
# number of the run of each lane.
SORT_RUNS = """\
define void @sort_runs(ptr %order, ptr %keys, ptr %numbers, ptr %counts, i64 %runs) {
entry:
  %some = icmp sgt i64 %runs, 0
  br i1 %some, label %run, label %done
run:
  %number = phi i64 [ 0, %entry ], [ %number.next, %run.end ]
  %begin = phi i64 [ 0, %entry ], [ %end, %run.end ]
  %count_at = getelementptr i64, ptr %counts, i64 %number
  %count = load i64, ptr %count_at, align 8
  %end = add i64 %begin, %count
  %short = trunc i64 %number to i32
  %none = icmp eq i64 %count, 0
  br i1 %none, label %run.end, label %first
first:
  %first_at = getelementptr i32, ptr %numbers, i64 %begin
  store i32 %short, ptr %first_at, align 4
  %second = add i64 %begin, 1
  %several = icmp slt i64 %second, %end
  br i1 %several, label %lane, label %run.end
lane:
  %i = phi i64 [ %second, %first ], [ %next, %placed ]
  %number_at = getelementptr i32, ptr %numbers, i64 %i
  store i32 %short, ptr %number_at, align 4
  %key_at = getelementptr i32, ptr %keys, i64 %i
  %key = load i32, ptr %key_at, align 4
  %lane_at = getelementptr i32, ptr %order, i64 %i
  %own = load i32, ptr %lane_at, align 4
  br label %look
look:
  %place = phi i64 [ %i, %lane ], [ %before, %moved ]
  %lowest = icmp eq i64 %place, %begin
  br i1 %lowest, label %placed, label %compare
compare:
  %before = add i64 %place, -1
  %other_at = getelementptr i32, ptr %keys, i64 %before
  %other = load i32, ptr %other_at, align 4
  %greater = icmp sgt i32 %other, %key
  br i1 %greater, label %moved, label %placed
moved:
  %moved_at = getelementptr i32, ptr %order, i64 %before
  %moved_lane = load i32, ptr %moved_at, align 4
  %moved_key_to = getelementptr i32, ptr %keys, i64 %place
  store i32 %other, ptr %moved_key_to, align 4
  %moved_to = getelementptr i32, ptr %order, i64 %place
  store i32 %moved_lane, ptr %moved_to, align 4
  br label %look
placed:
  %key_to = getelementptr i32, ptr %keys, i64 %place
  store i32 %key, ptr %key_to, align 4
  %to = getelementptr i32, ptr %order, i64 %place
  store i32 %own, ptr %to, align 4
  %next = add i64 %i, 1
  %more = icmp slt i64 %next, %end
  br i1 %more, label %lane, label %run.end
run.end:
  %number.next = add i64 %number, 1
  %others = icmp slt i64 %number.next, %runs
  br i1 %others, label %run, label %done
done:
  ret void
}
"""
LONGEST_RUN = 64  # that is sorted key by key


class _Code:
    """The compiled function that sorts each run of lanes by keys.

    It takes the addresses of lanes, keys, run numbers (written) and run lengths, and the number of runs.
    """

    def __init__(self) -> None:
        self.module = cached_code(SORT_RUNS, entry="sort_runs")
        self.sort_runs = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 4, ctypes.c_int64)(self.module.address)


code = made_once(_Code)


def in_order_on_cpu(major: Tensor, minor: Tensor, queues: int) -> tuple[Tensor, Tensor, Tensor]:
    """Sorts lanes by one number and, where that is equal, by another; args and results as of `order.in_order`."""
    order, found = partition_on_cpu(major, queues)
    counts = torch.frombuffer(found, dtype=torch.int64)
    if int(counts.max()) > LONGEST_RUN:
        order, _ = partition_on_cpu(minor, queues)
        order = order.index_select(0, partition_on_cpu(major.index_select(0, order), queues)[0])
        return order, major.index_select(0, order), minor.index_select(0, order)
    keys, numbers = minor.index_select(0, order), torch.empty_like(order)
    code().sort_runs(order.data_ptr(), keys.data_ptr(), numbers.data_ptr(), counts.data_ptr(), queues)
    return order, numbers, keys
