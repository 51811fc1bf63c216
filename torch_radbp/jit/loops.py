"""Functions in LLVM's text that are the same for every program, but for types."""

# Takes parts of a `team.Job` until none is left.
TAKE_PARTS = """\
define void @lanes_of_job(ptr %job) {
entry:
  %lanes = load i64, ptr %job, align 8
  %size_at = getelementptr i64, ptr %job, i64 1
  %size = load i64, ptr %size_at, align 8
  %next_at = getelementptr i64, ptr %job, i64 2
  %inputs_at = getelementptr i64, ptr %job, i64 3
  %inputs = load ptr, ptr %inputs_at, align 8
  %outputs_at = getelementptr i64, ptr %job, i64 4
  %outputs = load ptr, ptr %outputs_at, align 8
  br label %take
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
}
"""

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
