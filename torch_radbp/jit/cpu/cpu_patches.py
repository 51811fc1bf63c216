"""`jit/patches.py` on the CPU: one compiled loop over lanes, which adds all pixels of a patch one after the other."""

from __future__ import annotations

from array import array

import torch
from torch import Tensor

from torch_radbp.jit.cpu.machine import MachineCode, cached_code
from torch_radbp.jit.lane.loops import FEW_LANES, TAKE_PARTS
from torch_radbp.jit.recording.addition import SCALARS, VALUES, Patches
from torch_radbp.threads.made_once import made_once
from torch_radbp.threads.team import run_lanes

# The inputs: the first entries, the values, the numbers of rows and of entries from row to row, the weights of the columns,
# then of the rows. An entry of the totals is a vector of 4, the last of them 0.
HEAD = 1 + VALUES + 2
LANES = """\
define internal void @lanes(i64 %first, i64 %last, ptr %inputs, ptr %outputs) {{
entry:
  %totals = load ptr, ptr %outputs, align 8
  %entries = load ptr, ptr %inputs, align 8
  {words}
  br label %lane
lane:
  %i = phi i64 [ %first, %entry ], [ %i.next, %lane_done ]
  %entry_at = getelementptr i32, ptr %entries, i64 %i
  %found = load i32, ptr %entry_at, align 4
  %number = sext i32 %found to i64
  %corner = getelementptr <4 x double>, ptr %totals, i64 %number
  {lane}
  br label %row
row:
  %r = phi i64 [ 0, %lane ], [ %r.next, %row ]
  %start = phi ptr [ %corner, %lane ], [ %below, %row ]
  %place = add i64 %r, {rows_at}
  %down_at = getelementptr ptr, ptr %inputs, i64 %place
  %downs = load ptr, ptr %down_at, align 8
  %down_here = getelementptr {scalar}, ptr %downs, i64 %i
  %down = load {scalar}, ptr %down_here, align {size}
  {row}
  %below = getelementptr <4 x double>, ptr %start, i64 %apart
  %r.next = add i64 %r, 1
  %more_rows = icmp slt i64 %r.next, %rows
  br i1 %more_rows, label %row, label %lane_done
lane_done:
  %i.next = add i64 %i, 1
  %more = icmp slt i64 %i.next, %last
  br i1 %more, label %lane, label %done
done:
  ret void
}}
"""
WORD = "%{name}_at = getelementptr i64, ptr %inputs, i64 {place}\n  %{name} = load {kind}, ptr %{name}_at, align 8"
NUMBER = """\
%{name}_here = getelementptr {scalar}, ptr %{name}s, i64 %i
  %{name} = load {scalar}, ptr %{name}_here, align {size}"""
VALUE = "%v{k} = insertelement <4 x {scalar}> {before}, {scalar} %value{k}, i32 {k}"
ENTRY = """\
%w{c} = fmul {scalar} %down, %across{c}
  %one{c} = insertelement <4 x {scalar}> poison, {scalar} %w{c}, i32 0
  %all{c} = shufflevector <4 x {scalar}> %one{c}, <4 x {scalar}> poison, <4 x i32> zeroinitializer
  %counts{c} = fmul <4 x {scalar}> %v{last}, %all{c}
  {widened}
  %at{c} = getelementptr <4 x double>, ptr %start, i64 {c}
  %total{c} = load <4 x double>, ptr %at{c}, align 8
  %sum{c} = fadd <4 x double> %total{c}, %wide{c}
  store <4 x double> %sum{c}, ptr %at{c}, align 8"""
WIDENED = {torch.float32: "%wide{c} = fpext <4 x float> %counts{c} to <4 x double>",
           torch.float64: "%wide{c} = fadd <4 x double> %counts{c}, splat (double -0.0)"}


@made_once
def code_of(dtype: torch.dtype, columns: int) -> MachineCode:
    """The loop for patches of so many columns."""
    scalar, size, columns_of = SCALARS[dtype], dtype.itemsize, range(columns)
    pointers = [(f"value{k}s", 1 + k) for k in range(VALUES)] + [(f"across{c}s", HEAD + c) for c in columns_of]
    words = [WORD.format(name=name, place=place, kind="ptr") for name, place in pointers]
    words += [WORD.format(name=name, place=1 + VALUES + k, kind="i64") for k, name in enumerate(("rows", "apart"))]
    lane = [NUMBER.format(name=name.removesuffix("s"), scalar=scalar, size=size) for name, _ in pointers]
    lane += [VALUE.format(k=k, scalar=scalar, before=f"%v{k - 1}" if k else "zeroinitializer") for k in range(VALUES)]
    row = [ENTRY.format(c=c, scalar=scalar, last=VALUES - 1, widened=WIDENED[dtype].format(c=c)) for c in columns_of]
    text = LANES.format(words="\n  ".join(words), lane="\n  ".join(lane), row="\n  ".join(row), scalar=scalar, size=size,
                        rows_at=HEAD + columns)
    return cached_code("\n".join([TAKE_PARTS.format(width=1), FEW_LANES, text]))


def add_patches_on_cpu(patches: Patches, totals: Tensor) -> None:
    """Adds values of lanes to rectangles of pixels, lane by lane; args as of `patches.add_patches`, all contiguous."""
    first, values, down, across = patches
    inputs = array("q", [first.data_ptr(), *(value.data_ptr() for value in values), len(down), totals.shape[1],
                         *(weight.data_ptr() for weight in across), *(weight.data_ptr() for weight in down)])
    run_lanes(code_of(values[0].dtype, len(across)).address, len(first), inputs, array("q", [totals.data_ptr()]), len(first))
