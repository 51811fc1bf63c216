"""Kernels for GPUs that put lanes into queues, whose numbers of lanes stay on the device; see `launches.py`.

    lanes in runs of RUN, one a thread: how many of each run go to each queue   (count)
    sums of GROUP of these numbers, sums of GROUP of such sums, ...             (sum, level by level)
    each run puts its lanes where its part of each queue begins                 (place)

Counters lie queue by queue, those of all runs of a queue one after the other. Their running sums are where runs begin. No
thread waits for another, and lanes keep their order.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from torch_radbp.jit.nvidia.nvptx import kernel

RUN, GROUP = 32, 64
MOST_QUEUES = 64  # each takes a register of every thread

# The lanes of a run: `%j` from `%run.first` to before `%run.last`, with `%queue` and a counter `%c{q}` for each queue.
LANES_OF_RUN = """\
%all.lanes = load i64, ptr %total, align 8
%run.first = mul i64 %i, {run}
%run.full = add i64 %run.first, {run}
%run.over = icmp sgt i64 %run.full, %all.lanes
%run.last = select i1 %run.over, i64 %all.lanes, i64 %run.full
{begins}
%run.some = icmp slt i64 %run.first, %run.last
br i1 %run.some, label %turn, label %end
turn:
%j = phi i64 [ %run.first, %{before} ], [ %j.next, %turn.end ]
{counters}
%queue.at = getelementptr {scalar}, ptr %numbers, i64 %j
%queue.found = load {scalar}, ptr %queue.at, align {size}
{queue}
{steps}
{each}
%j.next = add i64 %j, 1
%j.more = icmp slt i64 %j.next, %run.last
br i1 %j.more, label %turn, label %end
end:"""
# How the queue of a lane is read, by whether lanes have flags: its number, or 0 if its flag is set.
QUEUE = {False: {"scalar": "i32", "size": 4, "queue": "%queue = add i32 %queue.found, 0"},
         True: {"scalar": "i8", "size": 1,
                "queue": "%queue.unset = icmp eq i8 %queue.found, 0\n%queue = zext i1 %queue.unset to i32"}}
STEP = """\
%is{q} = icmp eq i32 %queue, {q}
%one{q} = zext i1 %is{q} to i32
%c{q}.next = add i32 %c{q}, %one{q}"""
SUM = """\
%group.first = mul i64 %i, {group}
%group.full = add i64 %group.first, {group}
%group.over = icmp sgt i64 %group.full, %count
%group.last = select i1 %group.over, i64 %count, i64 %group.full
br label %turn
turn:
%j = phi i64 [ %group.first, %lane ], [ %j.next, %turn ]
%sum = phi i32 [ 0, %lane ], [ %sum.next, %turn ]
%value.at = getelementptr i32, ptr %values, i64 %j
%value = load i32, ptr %value.at, align 4
store i32 %sum, ptr %value.at, align 4
%sum.next = add i32 %sum, %value
%j.next = add i64 %j, 1
%j.more = icmp slt i64 %j.next, %group.last
br i1 %j.more, label %turn, label %summed
summed:
%total.at = getelementptr i32, ptr %totals, i64 %i
store i32 %sum.next, ptr %total.at, align 4"""


def lanes_of_run(queues: int, flags: bool, begins: Sequence[str], starts: Sequence[str], before: str,
                 each: Sequence[str]) -> list[str]:
    """The instructions that go through the lanes of a run.

    Args:
        queues: how many are counted.
        flags: whether lanes have flags rather than numbers.
        begins: instructions before the first lane.
        starts: of each counter its value there.
        before: the block that these are in.
        each: what is done with a lane.
    """
    counters = [f"%c{q} = phi i32 [ {start}, %{before} ], [ %c{q}.next, %turn.end ]" for q, start in enumerate(starts)]
    text = LANES_OF_RUN.format(run=RUN, begins="\n".join(begins), counters="\n".join(counters), before=before,
                               steps="\n".join(STEP.format(q=q) for q in range(queues)), each="\n".join(each),
                               **QUEUE[flags])
    return [line for line in text.splitlines() if line]


def count_text(case: tuple[int, bool]) -> str:
    """The LLVM IR of the kernel that counts the lanes of each run and queue, a run for each thread.

    Its parameters: numbers of queues, or flags; where the number of lanes stands; the counters; how many runs there are.

    Args:
        case: how many queues are counted, and whether lanes have flags: those of the queue 0.
    """
    queues, flags = case
    body = lanes_of_run(queues, flags, [], ["0"] * queues, "lane", ["br label %turn.end", "turn.end:"])
    body += [f"%f{q} = phi i32 [ 0, %lane ], [ %c{q}.next, %turn.end ]" for q in range(queues)]
    for q in range(queues):
        body += [f"%own{q} = mul i64 %runs, {q}", f"%counter{q} = add i64 %own{q}, %i",
                 f"%counter{q}.at = getelementptr i32, ptr %counters, i64 %counter{q}",
                 f"store i32 %f{q}, ptr %counter{q}.at, align 4"]
    return kernel("count", ["ptr readonly %numbers", "ptr readonly %total", "ptr %counters", "i64 %runs"], body)


def sum_text(case: tuple) -> str:
    """The LLVM IR of the kernel that makes values running sums, a group of them for each thread. Its parameters: the values,
    how many there are, and where the sum of each group goes."""
    return kernel("sum", ["ptr %values", "i64 %count", "ptr %totals"], SUM.format(group=GROUP).splitlines())


def place_text(case: tuple[int, bool, int]) -> str:
    """The LLVM IR of the kernel that puts lanes into their queues, a run of lanes for each thread.

    Its parameters: numbers or flags; where the number of lanes stands; the lanes, which are written; how many runs there
    are; where it goes in how many lanes each queue but the first begins, or how many flags are set; then the running sums,
    level by level.

    Args:
        case: how many queues are counted, whether lanes have flags, and the number of levels.
    """
    queues, flags, levels = case
    begins = [line for q in range(queues) for line in place_of_run(q, levels, "%i", f"begin{q}")]
    # The first run knows where queues begin.
    start = ["%leads = icmp eq i64 %i, 0", "br i1 %leads, label %borders.found, label %places", "borders.found:",
             *borders_found(queues, flags, levels), "br label %places", "places:", *begins]
    place, chain = "%c0", []
    for q in range(1, queues):
        chain.append(f"%place{q} = select i1 %is{q}, i32 %c{q}, i32 {place}")
        place = f"%place{q}"
    put = [f"%at.wide = sext i32 {place} to i64", "%order.at = getelementptr i32, ptr %order, i64 %at.wide",
           "%lane.number = trunc i64 %j to i32", "store i32 %lane.number, ptr %order.at, align 4", "br label %turn.end"]
    each = [*chain, "br i1 %is0, label %put, label %turn.end" if flags else "br label %put", "put:", *put, "turn.end:"]
    body = lanes_of_run(queues, flags, start, [f"%begin{q}" for q in range(queues)], "places", each)
    parameters = ["ptr readonly %numbers", "ptr readonly %total", "ptr %order", "i64 %runs", "ptr %borders",
                  *(f"ptr readonly %sums{level}" for level in range(levels + 1))]
    return kernel("place", parameters, body)


def place_of_run(queue: int, levels: int, run: str, name: str) -> Iterator[str]:
    """Instructions that find where the part of a run of a queue begins, `%name`."""
    yield f"%{name}.own = mul i64 %runs, {queue}"
    yield f"%{name}.at0 = add i64 %{name}.own, {run}"
    for level in range(levels):
        if level:
            yield f"%{name}.at{level} = udiv i64 %{name}.at{level - 1}, {GROUP}"
        yield f"%{name}.from{level} = getelementptr i32, ptr %sums{level}, i64 %{name}.at{level}"
        yield f"%{name}.part{level} = load i32, ptr %{name}.from{level}, align 4"
        before = f"%{name}.sum{level - 1}" if level else "0"
        yield f"%{name}{f'.sum{level}' if level < levels - 1 else ''} = add i32 {before}, %{name}.part{level}"


def borders_found(queues: int, flags: bool, levels: int) -> Iterator[str]:
    """Instructions that write where queues begin, or how many flags are set."""
    if flags:  # the sum of all
        yield f"%border0 = load i32, ptr %sums{levels}, align 4"
    for q in range(1, queues):
        yield from place_of_run(q, levels, "0", f"border{q}")
    for number, q in enumerate([0] if flags else range(1, queues)):
        yield f"%border{q}.wide = sext i32 %border{q} to i64"
        yield f"%border{q}.to = getelementptr i64, ptr %borders, i64 {number}"
        yield f"store i64 %border{q}.wide, ptr %border{q}.to, align 8"
