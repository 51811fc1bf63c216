"""`jit/order.py` on the CPU: compiled loops that only move data.

Those that count run on the calling thread, and their order is that of the lanes; the others are shared by threads.
"""

from __future__ import annotations

import ctypes
from array import array
from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from torch_radbp.jit.cpu.machine import MachineCode, cached_code
from torch_radbp.jit.lane.loops import FEW_LANES, TAKE_PARTS
from torch_radbp.threads.made_once import made_once
from torch_radbp.threads.team import run_lanes

# The body may begin with values that are carried from turn to turn.
LOOP = """\
define {result} @{name}({arguments}, i64 %count) {{
entry:
  %some = icmp sgt i64 %count, 0
  br i1 %some, label %turn, label %done
turn:
  %i = phi i64 [ 0, %entry ], [ %next, %turn ]
{body}
  %next = add i64 %i, 1
  %more = icmp slt i64 %next, %count
  br i1 %more, label %turn, label %done
done:
{end}
}}
"""
# A counter of each queue: begun at 0, it ends at the number of lanes; begun where the queue begins, it is each lane's place.
# Each lane waits for the counter that the last one has left, so that several runs of lanes, with counters of their own, are
# taken abreast.
COUNT = """\
  %run{k} = mul i64 %count, {k}
  %first{k} = add i64 %run{k}, %first
  %lane{k} = add i64 %first{k}, %i
  %number_at{k} = getelementptr {scalar}, ptr %numbers, i64 %lane{k}
  %number{k} = load {scalar}, ptr %number_at{k}
  %queue{k} = {wide} %number{k}{as_wide}
  %own{k} = mul i64 %queues, {k}
  %counter{k} = add i64 %own{k}, %queue{k}
  %place_at{k} = getelementptr i64, ptr %places, i64 %counter{k}
  %place{k} = load i64, ptr %place_at{k}, align 8
  %after{k} = add i64 %place{k}, 1
  store i64 %after{k}, ptr %place_at{k}, align 8"""
STORE_LANE = """\
  %lane_at{k} = getelementptr i32, ptr %order, i64 %place{k}
  %stored{k} = trunc i64 %lane{k} to i32
  store i32 %stored{k}, ptr %lane_at{k}, align 4"""
# The counters of a queue's runs, one after the other, become the places where each begins; `%found` are the queue's lanes.
BEGIN = """\
  %place0 = phi i64 [ 0, %entry ], [ %place{runs}, %turn ]
{counters}
  %lanes = sub i64 %place{runs}, %place0
  %found_at = getelementptr i64, ptr %found, i64 %i
  store i64 %lanes, ptr %found_at, align 8"""
BEGIN_RUN = """\
  %own{k} = mul i64 %count, {k}
  %counter{k} = add i64 %own{k}, %i
  %place_at{k} = getelementptr i64, ptr %places, i64 %counter{k}
  %lanes{k} = load i64, ptr %place_at{k}, align 8
  store i64 %place{k}, ptr %place_at{k}, align 8
  %place{after} = add i64 %place{k}, %lanes{k}"""
# Without a branch: a lane that is not chosen is overwritten by the next.
CHOOSE = """\
  %place = phi i64 [ 0, %entry ], [ %after, %turn ]
  %lane_at = getelementptr i32, ptr %order, i64 %place
  %lane = trunc i64 %i to i32
  store i32 %lane, ptr %lane_at, align 4
  %flag_at = getelementptr i8, ptr %flags, i64 %i
  %flag = load i8, ptr %flag_at, align 1
  %one = zext i8 %flag to i64
  %after = add i64 %place, %one"""
CHOSEN = """\
  %number = phi i64 [ 0, %entry ], [ %after, %turn ]
  ret i64 %number"""
# Loops of `team.run_lanes`. The inputs of the first are places, the number of tensors, and their entries.
PUT = """\
define internal void @lanes(i64 %first, i64 %last, ptr %inputs, ptr %outputs) {{
entry:
  %places = load ptr, ptr %inputs, align 8
  %count_at = getelementptr i64, ptr %inputs, i64 1
  %count = load i64, ptr %count_at, align 8
  br label %tensor
tensor:
  %number = phi i64 [ 0, %entry ], [ %number.next, %tensor.end ]
  %from_number = add i64 %number, 2
  %from_at = getelementptr ptr, ptr %inputs, i64 %from_number
  %from = load ptr, ptr %from_at, align 8
  %to_at = getelementptr ptr, ptr %outputs, i64 %number
  %to = load ptr, ptr %to_at, align 8
  br label %lane
lane:
  %i = phi i64 [ %first, %tensor ], [ %next, %lane ]
  %place_at = getelementptr i32, ptr %places, i64 %i
  %place32 = load i32, ptr %place_at, align 4
  %place = sext i32 %place32 to i64
  %entry_at = getelementptr {scalar}, ptr %from, i64 %i
  %entry_value = load {scalar}, ptr %entry_at
  %target = getelementptr {scalar}, ptr %to, i64 %place
  store {scalar} %entry_value, ptr %target
  %next = add i64 %i, 1
  %more = icmp slt i64 %next, %last
  br i1 %more, label %lane, label %tensor.end
tensor.end:
  %number.next = add i64 %number, 1
  %others = icmp slt i64 %number.next, %count
  br i1 %others, label %tensor, label %done
done:
  ret void
}}
"""
INVERT = """\
define internal void @lanes(i64 %first, i64 %last, ptr noalias %inputs, ptr noalias %outputs) {
entry:
  %flags = load ptr, ptr %inputs, align 8
  %result = load ptr, ptr %outputs, align 8
  br label %lane
lane:
  %i = phi i64 [ %first, %entry ], [ %next, %lane ]
  %from = getelementptr i8, ptr %flags, i64 %i
  %flag = load i8, ptr %from
  %other = xor i8 %flag, 1
  %to = getelementptr i8, ptr %result, i64 %i
  store i8 %other, ptr %to
  %next = add i64 %i, 1
  %more = icmp slt i64 %next, %last
  br i1 %more, label %lane, label %done
done:
  ret void
}
"""
BITS = (8, 32, 64)  # of an element
ABREAST = 4  # runs of lanes
FEW_LANES_OF_QUEUE = 64
ZERO = array("q", [0])
COUNTERS = "ptr %places, i64 %queues, i64 %first"


def _loop(name: str, arguments: str, body: str, result: str = "void", end: str = "  ret void") -> str:
    """The LLVM IR of a function that runs `body` for each `%i` below its last argument, `%count`."""
    return LOOP.format(name=name, arguments=arguments, body=body, result=result, end=end)


def _text() -> str:
    """The LLVM IR of loops that count, partition, select and scatter lanes, for each size of an entry."""
    begins = "\n".join(BEGIN_RUN.format(k=k, after=k + 1) for k in range(ABREAST))
    functions = [_loop("choose", "ptr %flags, ptr %order", CHOOSE, "i64", CHOSEN),
                 _loop("begin", "ptr %places, ptr %found", BEGIN.format(runs=ABREAST, counters=begins))]
    for bits in BITS:
        scalar = f"i{bits}"
        wide, as_wide = ("add i64", ", 0") if bits == 64 else (f"zext {scalar}", " to i64")
        for name, runs in (("abreast", range(ABREAST)), ("rest", range(1))):
            counts = [COUNT.format(scalar=scalar, wide=wide, as_wide=as_wide, k=k) for k in runs]
            stores = [STORE_LANE.format(k=k) for k in runs]
            functions += [
                _loop(f"count_{name}_{scalar}", f"ptr %numbers, {COUNTERS}", "\n".join(counts)),
                _loop(f"partition_{name}_{scalar}", f"ptr %order, ptr %numbers, {COUNTERS}", "\n".join([*counts, *stores]))]
    return "\n".join(functions)


class _Code:
    """The compiled functions that count, partition and select lanes, by bytes of an entry."""

    def __init__(self) -> None:
        self.module = cached_code(_text(), entry="choose")
        self.choose, self.begin = self.function("choose", "ppn", ctypes.c_int64), self.function("begin", "ppn")
        self.count, self.count_rest, self.partition, self.partition_rest = (
            {bits // 8: self.function(f"{name}_i{bits}", arguments) for bits in BITS}
            for name, arguments in (("count_abreast", "ppnnn"), ("count_rest", "ppnnn"), ("partition_abreast", "pppnnn"),
                                    ("partition_rest", "pppnnn")))

    def function(self, name: str, arguments: str, result: type | None = None) -> Callable:
        """A compiled function; `arguments` has a letter for each argument: p for a pointer, n for a number."""
        kinds = {"p": ctypes.c_void_p, "n": ctypes.c_int64}
        return ctypes.CFUNCTYPE(result, *(kinds[letter] for letter in arguments))(self.module.address_of(name))


code = made_once(_Code)


@made_once
def putting(size: int) -> MachineCode:
    """The compiled loop that scatters entries of so many bytes to given places."""
    return cached_code(TAKE_PARTS.format(width=1) + FEW_LANES + PUT.format(scalar=f"i{8 * size}"))


@made_once
def inverting() -> MachineCode:
    """The compiled loop that inverts flags."""
    return cached_code(TAKE_PARTS.format(width=1) + FEW_LANES + INVERT)


@made_once
def addresses() -> dict[str, int]:
    """The addresses of the compiled functions that count, partition and select lanes, by name."""
    names = ["choose", "begin", *(f"{name}_i{bits}" for bits in BITS for name in (
        "count_abreast", "count_rest", "partition_abreast", "partition_rest"))]
    return {name: code().module.address_of(name) for name in names}


def inverted_on_cpu(flags: Tensor) -> Tensor:
    """The negation of flags, (N,) bool."""
    return ~flags


def nothing_on_cpu(flags: Tensor) -> Tensor:
    """(N,) bool, false for every lane of `flags`."""
    return torch.zeros_like(flags)


def chosen_on_cpu(flags: Tensor) -> Tensor:
    """The lanes whose flag is set, (M,) int32 in their order, by a compiled loop on this thread."""
    flags = flags.contiguous()
    order = flags.new_empty(flags.numel(), dtype=torch.int32)
    return order[:code().choose(flags.data_ptr(), order.data_ptr(), flags.numel())]


def partition_on_cpu(number: Tensor, queues: int) -> tuple[Tensor, Sequence[int]]:
    """Sorts lanes into queues by compiled loops on this thread: args and results as of `order.partition`."""
    number, lanes, size = number.contiguous(), number.numel(), number.element_size()
    order = number.new_empty(lanes, dtype=torch.int32)
    if queues * FEW_LANES_OF_QUEUE > lanes:
        return partitioned_by_many(number, queues, order)
    counts = ZERO * (queues * ABREAST)  # of all queues for each run; what is left over goes on with the last
    numbers, counters, run = number.data_ptr(), counts.buffer_info()[0], lanes // ABREAST
    last, first, rest = counters + 8 * queues * (ABREAST - 1), ABREAST * run, lanes % ABREAST
    code().count[size](numbers, counters, queues, 0, run)
    code().count_rest[size](numbers, last, queues, first, rest)
    found = ZERO * queues
    code().begin(counters, found.buffer_info()[0], queues)
    code().partition[size](order.data_ptr(), numbers, counters, queues, 0, run)
    code().partition_rest[size](order.data_ptr(), numbers, last, queues, first, rest)
    return order, found


def partitioned_by_many(number: Tensor, queues: int, order: Tensor) -> tuple[Tensor, Sequence[int]]:
    """Sorts lanes into many short queues, with one set of counters; writes `order`."""
    size, found = number.element_size(), ZERO * queues
    code().count_rest[size](number.data_ptr(), found.buffer_info()[0], queues, 0, number.numel())
    counts = torch.frombuffer(found, dtype=torch.int64)
    places = counts.cumsum(0).sub_(counts)
    code().partition_rest[size](order.data_ptr(), number.data_ptr(), places.data_ptr(), queues, 0, number.numel())
    return order, found


def put_on_cpu(targets: Sequence[Tensor], place: Tensor, entries: Sequence[Tensor]) -> None:
    """Scatters entries into tensors by compiled loops on several threads; args as of `order.put`, all contiguous."""
    for size in {target.element_size() for target in targets}:
        pairs = [(target, entry) for target, entry in zip(targets, entries) if target.element_size() == size]
        inputs = array("q", [place.data_ptr(), len(pairs), *[entry.data_ptr() for _, entry in pairs]])
        run_lanes(putting(size).address, place.numel(), inputs, array("q", [target.data_ptr() for target, _ in pairs]))
