"""LLVM IR of functions that are the same for every program, but for types and counts."""

from collections.abc import Sequence

# Writes a `team.Job`, of which nobody has taken a part.
WRITE_JOB = """\
  store i64 %lanes, ptr %job, align 8
  %part_at = getelementptr i64, ptr %job, i64 1
  store i64 %part, ptr %part_at, align 8
  %next_at = getelementptr i64, ptr %job, i64 2
  store i64 0, ptr %next_at, align 8
  %inputs_at = getelementptr i64, ptr %job, i64 3
  store ptr %inputs, ptr %inputs_at, align 8
  %outputs_at = getelementptr i64, ptr %job, i64 4
  store ptr %outputs, ptr %outputs_at, align 8
"""

# Takes parts of a `team.Job` until none is left; fewer lanes than a block has go by `few_lanes`.
TAKE_PARTS = """\
define void @lanes_of_job(ptr %job) {{
entry:
  %lanes = load i64, ptr %job, align 8
  %size_at = getelementptr i64, ptr %job, i64 1
  %size = load i64, ptr %size_at, align 8
  %next_at = getelementptr i64, ptr %job, i64 2
  %inputs_at = getelementptr i64, ptr %job, i64 3
  %inputs = load ptr, ptr %inputs_at, align 8
  %outputs_at = getelementptr i64, ptr %job, i64 4
  %outputs = load ptr, ptr %outputs_at, align 8
  %few = icmp slt i64 %lanes, {width}
  br i1 %few, label %block, label %take
block:
  call void @few_lanes(i64 %lanes, ptr %inputs, ptr %outputs)
  ret void
take:
  %first = atomicrmw add ptr %next_at, i64 %size monotonic
  %left = icmp slt i64 %first, %lanes
  br i1 %left, label %work, label %done
work:
  %end = add i64 %first, %size
  %over = icmp sgt i64 %end, %lanes
  %last = select i1 %over, i64 %lanes, i64 %end
  call void @lanes(i64 %first, i64 %last, ptr %inputs, ptr %outputs)
  br label %take
done:
  ret void
}}
"""

# For loops to which fewer lanes than a block has are no special case.
FEW_LANES = """\
define internal void @few_lanes(i64 %lanes, ptr %inputs, ptr %outputs) {
  call void @lanes(i64 0, i64 %lanes, ptr %inputs, ptr %outputs)
  ret void
}
"""

# Copies `lanes` elements to a block of `width`, and repeats the last until it is full.
FILL = """\
define internal void @fill(ptr %block, ptr %elements, i64 %lanes, i64 %size, i64 %width) {
entry:
  %last = sub i64 %lanes, 1
  br label %copy
copy:
  %lane = phi i64 [ 0, %entry ], [ %next, %copy ]
  %over = icmp sgt i64 %lane, %last
  %from = select i1 %over, i64 %last, i64 %lane
  %source_at = mul i64 %from, %size
  %source = getelementptr i8, ptr %elements, i64 %source_at
  %target_at = mul i64 %lane, %size
  %target = getelementptr i8, ptr %block, i64 %target_at
  call void @llvm.memcpy.p0.p0.i64(ptr %target, ptr %source, i64 %size, i1 false)
  %next = add i64 %lane, 1
  %more = icmp slt i64 %next, %width
  br i1 %more, label %copy, label %done
done:
  ret void
}
declare void @llvm.memcpy.p0.p0.i64(ptr, ptr, i64, i1)
"""


def few_lanes(inputs: Sequence[int], outputs: Sequence[int], width: int) -> str:
    """The function for fewer lanes than a block: copies them to a block of its own, padded with the last lane.

    Args:
        inputs: bytes of an element of each input of the lanes; 0: a table or a number.
        outputs: the same of each output.
        width: lanes in a block.
    """
    count = 2 * len(inputs) + len(outputs)  # behind the inputs stand their lengths
    lines = [f"%places = alloca [{max(1, count)} x ptr]",
             f"call void @llvm.memcpy.p0.p0.i64(ptr %places, ptr %inputs, i64 {16 * len(inputs)}, i1 false)"]
    back = []
    for k, size in enumerate((*inputs, *[0] * len(inputs), *outputs)):
        if size == 0:
            continue
        number, array = (k, "%inputs") if k < len(inputs) else (k - 2 * len(inputs), "%outputs")
        lines += [f"%block{k} = alloca [{width * size} x i8], align 64",
                  f"%at{k} = getelementptr ptr, ptr {array}, i64 {number}", f"%given{k} = load ptr, ptr %at{k}, align 8",
                  f"%place{k} = getelementptr ptr, ptr %places, i64 {k}", f"store ptr %block{k}, ptr %place{k}, align 8"]
        if array == "%inputs":
            lines.append(f"call void @fill(ptr %block{k}, ptr %given{k}, i64 %lanes, i64 {size}, i64 {width})")
        else:
            back += [f"%bytes{k} = mul i64 %lanes, {size}",
                     f"call void @llvm.memcpy.p0.p0.i64(ptr %given{k}, ptr %block{k}, i64 %bytes{k}, i1 false)"]
    lines += [f"%results = getelementptr ptr, ptr %places, i64 {2 * len(inputs)}",
              f"call void @lanes(i64 0, i64 {width}, ptr %places, ptr %results)", *back, "ret void"]
    body = "\n".join(f"  {line}" for line in lines)
    return f"{FILL}define internal void @few_lanes(i64 %lanes, ptr %inputs, ptr %outputs) {{\n{body}\n}}"


# Halves what is left of the table until nothing is; all lanes take the same number of turns.
SEARCH = """\
define internal {counts} @{function}(ptr %table, i64 %length, {numbers} %x) {{
entry:
  %some = icmp sgt i64 %length, 0
  br i1 %some, label %turn, label %done
turn:
  %left = phi i64 [ %length, %entry ], [ %rest, %turn ]
  %low = phi {counts} [ {zero}, %entry ], [ %moved, %turn ]
  %more = add i64 %left, 1
  %half = lshr i64 %more, 1
  {spread}
  %beyond = add {counts} %low, %step
  %last = sub {counts} %beyond, {one}
  %places = getelementptr {scalar}, ptr %table, {counts} %last
  %entries = {read}
  %within = fcmp ole {numbers} %entries, %x
  %moved = select {flags} %within, {counts} %beyond, {counts} %low
  %rest = sub i64 %left, %half
  %again = icmp sgt i64 %rest, 0
  br i1 %again, label %turn, label %done
done:
  %result = phi {counts} [ {zero}, %entry ], [ %moved, %turn ]
  ret {counts} %result
}}"""
