"""`jit/scatter.py` on the CPU: compiled loops in the order of the lanes.

The tables of an addition are written in one loop over the lanes, and all additions to the same tables take turns in blocks
of lanes, so that entries that lie near each other (the four texels around a point) are still in the cache. Those to other
tables may run on other threads.
"""

from __future__ import annotations

import itertools
from array import array
from collections.abc import Sequence

import torch

from torch_radbp.jit.cpu.machine import cached_code
from torch_radbp.jit.lane.loops import FEW_LANES, TAKE_PARTS
from torch_radbp.jit.recording.addition import MOST_TABLES, PAGE_BITS, SCALARS, Addition, side_by_side
from torch_radbp.jit.recording.recording import recording
from torch_radbp.threads.made_once import made_once
from torch_radbp.threads.team import run_lanes

BLOCK = 2048  # lanes
SHARED = 1 << 14  # lanes, so many at least that it is worth to wake a thread

# A job is an array of 64-bit words: the function, the index, the pages, the distance from entry to entry of the totals, the
# number of copies less 1, then the numbers of each table, then the totals of each.
HEAD = 5
JOB = HEAD + 2 * MOST_TABLES

SCATTER = """\
define void @scatter_{scalar}_{tables}(ptr %job, i64 %first, i64 %last) {{
entry:
  %index = call ptr @pointer(ptr %job, i64 1)
  %pages = call ptr @pointer(ptr %job, i64 2)
  %step = call i64 @word(ptr %job, i64 3)
  %mask = call i64 @word(ptr %job, i64 4)
  {pointers}
  br label %lane
lane:
  %i = phi i64 [ %first, %entry ], [ %next, %lane ]
  %at = getelementptr i32, ptr %index, i64 %i
  %found = load i32, ptr %at, align 4
  %number = sext i32 %found to i64
  %page_number = lshr i64 %number, {page_bits}
  %page = getelementptr i8, ptr %pages, i64 %page_number
  store i8 1, ptr %page, align 1
  %copy = and i64 %i, %mask
  %copies = mul i64 %number, %step
  %place = add i64 %copies, %copy
  {additions}
  %next = add i64 %i, 1
  %more = icmp slt i64 %next, %last
  br i1 %more, label %lane, label %done
done:
  ret void
}}
"""
POINTERS = """\
  %numbers{t} = call ptr @pointer(ptr %job, i64 {numbers})
  %totals{t} = call ptr @pointer(ptr %job, i64 {totals})"""
ADDITION = """\
  %from{t} = getelementptr {scalar}, ptr %numbers{t}, i64 %i
  %number{t} = load {scalar}, ptr %from{t}, align {size}
  %wide{t} = {widened}
  %to{t} = getelementptr double, ptr %totals{t}, i64 %place
  %total{t} = load double, ptr %to{t}, align 8
  %sum{t} = fadd double %total{t}, %wide{t}
  store double %sum{t}, ptr %to{t}, align 8"""
JOBS = """\
define internal i64 @word(ptr %job, i64 %number) {{
  %at = getelementptr i64, ptr %job, i64 %number
  %word = load i64, ptr %at, align 8
  ret i64 %word
}}
define internal ptr @pointer(ptr %job, i64 %number) {{
  %word = call i64 @word(ptr %job, i64 %number)
  %pointer = inttoptr i64 %word to ptr
  ret ptr %pointer
}}
define internal void @scatter(ptr %jobs, i64 %count, i64 %lanes) {{
entry:
  br label %block
block:
  %first = phi i64 [ 0, %entry ], [ %last, %blocks ]
  %full = add i64 %first, {block}
  %over = icmp sgt i64 %full, %lanes
  %last = select i1 %over, i64 %lanes, i64 %full
  br label %turn
turn:
  %k = phi i64 [ 0, %block ], [ %next, %turn ]
  %words = mul i64 %k, {job}
  %job = getelementptr i64, ptr %jobs, i64 %words
  %function = call ptr @pointer(ptr %job, i64 0)
  call void %function(ptr %job, i64 %first, i64 %last)
  %next = add i64 %k, 1
  %more = icmp slt i64 %next, %count
  br i1 %more, label %turn, label %blocks
blocks:
  %left = icmp slt i64 %last, %lanes
  br i1 %left, label %block, label %done
done:
  ret void
}}
"""
# A loop of `team.run_lanes` over groups of jobs. The inputs are the jobs, the number of lanes, the first job of each group,
# and the number of jobs.
GROUPS = """define internal void @lanes(i64 %first, i64 %last, ptr %inputs, ptr %outputs) {{
entry:
  %jobs = call ptr @pointer(ptr %inputs, i64 0)
  %count = call i64 @word(ptr %inputs, i64 1)
  br label %look
look:
  %group = phi i64 [ %first, %entry ], [ %next, %turn ]
  %next = add i64 %group, 1
  %left = icmp slt i64 %group, %last
  br i1 %left, label %turn, label %done
turn:
  %begin_at = add i64 %group, 2
  %begin = call i64 @word(ptr %inputs, i64 %begin_at)
  %end_at = add i64 %group, 3
  %end = call i64 @word(ptr %inputs, i64 %end_at)
  %words = mul i64 %begin, {job}
  %own = getelementptr i64, ptr %jobs, i64 %words
  %number = sub i64 %end, %begin
  call void @scatter(ptr %own, i64 %number, i64 %count)
  br label %look
done:
  ret void
}}
"""


def _text() -> str:
    """The LLVM IR: a loop over lanes for each dtype and number of tables, and loops over jobs and groups of these."""
    functions = [TAKE_PARTS.format(width=1), FEW_LANES, JOBS.format(block=BLOCK, job=JOB), GROUPS.format(job=JOB)]
    for dtype, scalar in SCALARS.items():
        widened = "fpext float %number{t} to double" if dtype == torch.float32 else "fadd double %number{t}, -0.0"
        for tables in range(1, MOST_TABLES + 1):
            pointers = [POINTERS.format(t=t, numbers=HEAD + t, totals=HEAD + MOST_TABLES + t) for t in range(tables)]
            additions = [ADDITION.format(t=t, scalar=scalar, size=dtype.itemsize, widened=widened.format(t=t))
                         for t in range(tables)]
            functions.append(SCATTER.format(scalar=scalar, tables=tables, page_bits=PAGE_BITS, pointers="\n".join(pointers),
                                            additions="\n".join(additions)))
    return "\n".join(functions)


class _Code:
    """The compiled functions that scatter-add numbers of lanes, by dtype and number of tables."""

    def __init__(self) -> None:
        self.module = cached_code(_text())
        self.loops = {(dtype, tables): self.module.address_of(f"scatter_{scalar}_{tables}")
                      for dtype, scalar in SCALARS.items() for tables in range(1, MOST_TABLES + 1)}


code = made_once(_Code)


def scatter_add_on_cpu(additions: Sequence[Addition], lanes: int) -> None:
    """Scatter-adds on the CPU; see `scatter.scatter_add`; all is contiguous."""
    loops, groups = code().loops, side_by_side(additions)
    if (listener := recording()) is not None:
        listener.scatter_add(groups, lanes, loops)
        return
    words, borders = array("q"), [0, *itertools.accumulate(map(len, groups))]
    for index, numbers, sums in itertools.chain.from_iterable(groups):
        spare = [0] * (MOST_TABLES - len(numbers))
        words.extend([loops[numbers[0].dtype, len(numbers)], index.data_ptr(), *sums.words,
                      *[number.data_ptr() for number in numbers], *spare, *sums.addresses, *spare])
    inputs = array("q", [words.buffer_info()[0], lanes, *borders])
    run_lanes(code().module.address, len(groups), inputs, array("q", [0]), len(groups) if lanes < SHARED else 1)
