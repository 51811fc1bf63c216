"""The LLVM IR of a recording; see `recorded.py`.

    void recorded0(ptr given, ptr kept, ptr room, ptr counts, ptr functions, ptr board, i64 lanes, i64 row)

`given` holds addresses and, behind them, lengths; `kept` and `room` the memory of what is made, in rows of `row` entries:
that of results, and that of what nobody asks for afterwards. Counts are read from `counts` and written there. `functions`
holds the addresses of whatever is called. Where something is done outside, the code is left: what comes then is the next
function, `recorded1`, which finds the same memory and counts, and in `kept` what was handed over.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

from torch_radbp.jit.cpu import cpu_order, cpu_scatter
from torch_radbp.jit.cpu.board import run_loop
from torch_radbp.jit.recording.addition import MOST_TABLES
from torch_radbp.jit.recording.lane_operations import (
    Chosen,
    Copy,
    Inverted,
    LaneSpan,
    LoopBody,
    MemoryPlace,
    Operation,
    Outside,
    Partition,
    Put,
    RecordedLoop,
    Repeated,
    Scattered,
)
from torch_radbp.jit.recording.recording import Recording
from torch_radbp.jit.recording.results import ResultLayout
from torch_radbp.threads.team import PART

HEAD = """\
define void @recorded{number}(ptr %given, ptr %kept, ptr %room, ptr %counts, ptr %functions, ptr %board,
                              i64 %lanes, i64 %row) {{
entry:"""
# Runs of lanes abreast, as `cpu_order.partition_on_cpu` takes them.
PARTITION = """\
define internal void @partition(ptr %functions, ptr %order, ptr %numbers, i64 %lanes, i64 %queues, ptr %found) {{
  %bytes = mul i64 %queues, {bytes}
  %counters = alloca i8, i64 %bytes, align 8
  call void @llvm.memset.p0.i64(ptr %counters, i8 0, i64 %bytes, i1 false)
  %run = sdiv i64 %lanes, {abreast}
  %first = mul i64 %run, {abreast}
  %rest = sub i64 %lanes, %first
  %before = mul i64 %queues, {before}
  %last = getelementptr i8, ptr %counters, i64 %before
  {loads}
  call void %count(ptr %numbers, ptr %counters, i64 %queues, i64 0, i64 %run)
  call void %count_rest(ptr %numbers, ptr %last, i64 %queues, i64 %first, i64 %rest)
  call void %begin(ptr %counters, ptr %found, i64 %queues)
  call void %put(ptr %order, ptr %numbers, ptr %counters, i64 %queues, i64 0, i64 %run)
  call void %put_rest(ptr %order, ptr %numbers, ptr %last, i64 %queues, i64 %first, i64 %rest)
  ret void
}}
declare void @llvm.memset.p0.i64(ptr, i8, i64, i1)
declare void @llvm.memcpy.p0.p0.i64(ptr, ptr, i64, i1)
"""


class Writer:
    """Writes the LLVM IR of a recording, and collects the functions that it calls."""

    def __init__(self, recording: Recording, layout: ResultLayout, given: int):
        self.recording, self.layout, self.given = recording, layout, given
        self.functions: list[int | LoopBody] = []
        self.lines: list[str] = []  # of the function that is being written
        self.arrays: list[str] = []  # memory on the stack, which is reserved once where it begins
        self.block = "entry"  # in which the next line stands
        self.addresses: dict[MemoryPlace, str] = {}  # that are known there
        self.counts = {0: "0", 1: "%lanes", **dict.fromkeys(range(2, 2 + recording.given_counts), "")}

    def line(self, text: str) -> str:
        """Appends an instruction and returns the name of its result."""
        name = f"%v{len(self.lines)}"
        self.lines.append(f"{name} = {text}")
        return name

    def array(self, kind: str, entries: int) -> str:
        """Reserves an array on the stack and returns the name of its address."""
        name = f"%a{len(self.arrays)}"
        self.arrays.append(f"{name} = alloca {kind}, i64 {max(1, entries)}, align 8")
        return name

    def begin(self, block: str) -> None:
        """Begins a block of instructions."""
        self.lines.append(f"{block}:")
        self.block = block

    def function(self, function: int | LoopBody) -> str:
        """The name of the pointer to a function."""
        if function not in self.functions:
            self.functions.append(function)
        at = self.line(f"getelementptr ptr, ptr %functions, i64 {self.functions.index(function)}")
        return self.line(f"load ptr, ptr {at}, align 8")

    def number_of(self, lanes: LaneSpan) -> str:
        """The name of the number of lanes in a span."""
        return self.line(f"sub i64 {self.counts[lanes.last]}, {self.counts[lanes.first]}")

    def address(self, place: MemoryPlace) -> str:
        """The name of the pointer to a place in memory."""
        if place not in self.addresses:
            self.addresses[place] = self.new_address(place)
        return self.addresses[place]

    def new_address(self, place: MemoryPlace) -> str:
        """Emits the computation of the pointer to a place in memory."""
        if not place.made:
            at = self.line(f"getelementptr ptr, ptr %given, i64 {place.tensor}")
            return self.moved(self.line(f"load ptr, ptr {at}, align 8"), place)
        if place.tensor in self.layout.rows:
            group, row = self.layout.rows[place.tensor]
            at = self.line(f"getelementptr ptr, ptr %kept, i64 {group}")
            base, before = self.line(f"load ptr, ptr {at}, align 8"), row * place.size
        else:
            base, before = "%room", self.layout.at[place.tensor]
        return self.moved(self.line(f"getelementptr i8, ptr {base}, i64 {self.line(f'mul i64 %row, {before}')}"), place)

    def moved(self, base: str, place: MemoryPlace) -> str:
        """Emits the pointer moved by the offset of a place."""
        if not place.first:
            return base
        before = self.line(f"mul i64 {self.counts[place.first]}, {place.size}")
        return self.line(f"getelementptr i8, ptr {base}, i64 {before}")

    def list_of(self, pointers: Sequence[str]) -> str:
        """Emits an array of pointers, and returns the name of its address."""
        array = self.array("ptr", len(pointers))
        for number, pointer in enumerate(pointers):
            at = self.line(f"getelementptr ptr, ptr {array}, i64 {number}")
            self.lines.append(f"store ptr {pointer}, ptr {at}, align 8")
        return array

    def loop(self, operation: RecordedLoop) -> None:
        inputs = [self.address(place) for place in operation.inputs]
        for place, lanes in zip(operation.inputs, operation.lengths or ()):
            if place.made:
                inputs.append(self.line(f"inttoptr i64 {self.number_of(lanes)} to ptr"))
            else:
                at = self.line(f"getelementptr ptr, ptr %given, i64 {self.given + place.tensor}")
                inputs.append(self.line(f"load ptr, ptr {at}, align 8"))
        self.call(operation.body, self.number_of(operation.lanes), operation.part, inputs,
                  [self.address(place) for place in operation.outputs])

    def call(self, body: int | LoopBody, number: str, part: int, inputs: Sequence[str], outputs: Sequence[str]) -> None:
        """Emits the call that runs a loop over `number` lanes."""
        run, function = self.function(run_loop()), self.function(body)
        self.lines.append(f"call void {run}(ptr %board, ptr {function}, i64 {number}, i64 {part}, "
                          f"ptr {self.list_of(inputs)}, ptr {self.list_of(outputs)})")

    def partition(self, operation: Partition) -> None:
        found = self.array("i64", operation.queues)
        self.lines.append(f"call void @partition(ptr %functions, ptr {self.address(operation.order)}, "
                          f"ptr {self.address(operation.number)}, i64 {self.number_of(operation.lanes)}, "
                          f"i64 {operation.queues}, ptr {found})")
        border = "0"
        for number in range(operation.queues - 1):
            at = self.line(f"getelementptr i64, ptr {found}, i64 {number}")
            border = self.line(f"add i64 {border}, {self.line(f'load i64, ptr {at}, align 8')}")
            self.counts[operation.first + number] = border

    def chosen(self, operation: Chosen) -> None:
        choose, flags, order = (self.function(cpu_order.addresses()["choose"]), self.address(operation.flags),
                                self.address(operation.order))
        self.counts[operation.count] = self.line(
            f"call i64 {choose}(ptr {flags}, ptr {order}, i64 {self.number_of(operation.lanes)})")

    def put(self, operation: Put) -> None:
        size, pairs = operation.pairs[0][0].size, operation.pairs
        inputs = [self.address(operation.place), f"inttoptr (i64 {len(pairs)} to ptr)",
                  *[self.address(entry) for entry, _ in pairs]]
        self.call(cpu_order.putting(size).address, self.number_of(operation.lanes), PART, inputs,
                  [self.address(target) for _, target in pairs])

    def inverted(self, operation: Inverted) -> None:
        result = self.address(operation.result)
        if operation.flags is None:
            lanes = self.number_of(operation.lanes)
            self.lines.append(f"call void @llvm.memset.p0.i64(ptr {result}, i8 0, i64 {lanes}, i1 false)")
        else:
            self.call(cpu_order.inverting().address, self.number_of(operation.lanes), PART, [self.address(operation.flags)],
                      [result])

    def copy(self, operation: Copy) -> None:
        source, target = self.address(operation.source), self.address(operation.target)
        size = self.line(f"mul i64 {self.number_of(operation.lanes)}, {operation.target.size}")
        self.lines.append(f"call void @llvm.memcpy.p0.p0.i64(ptr {target}, ptr {source}, i64 {size}, i1 false)")

    def scattered(self, operation: Scattered) -> None:
        words, groups, lanes = [], operation.groups, self.number_of(operation.lanes)
        for loop, index, touched, step, mask, numbers, totals in itertools.chain.from_iterable(groups):
            places = [*map(self.address, numbers)], [*map(self.address, totals)]
            words += [self.function(loop), self.address(index), self.address(touched), f"inttoptr (i64 {step} to ptr)",
                      f"inttoptr (i64 {mask} to ptr)",
                      *[item for found in places for item in [*found, *["null"] * (MOST_TABLES - len(found))]]]
        borders = [f"inttoptr (i64 {border} to ptr)" for border in (0, *itertools.accumulate(map(len, groups)))]
        inputs = [self.list_of(words), self.line(f"inttoptr i64 {lanes} to ptr"), *borders]
        some = self.line(f"icmp sgt i64 {lanes}, 0")
        number = self.line(f"select i1 {some}, i64 {len(groups)}, i64 0")
        self.call(cpu_scatter.code().module.address, number, 1, inputs, [])

    def repeated(self, operation: Repeated) -> None:
        name, outer, before = f"repeated{operation.count}", dict(self.counts), dict(self.addresses)
        start, lanes, cast = self.number_of(operation.start), self.address(operation.lanes), self.array("i64", 1)
        self.lines += [f"store i64 0, ptr {cast}, align 8", f"br label %{name}"]
        entered = self.block
        self.begin(name)
        self.counts[operation.count], turn = f"%{name}_lanes", len(self.lines)
        self.lines += ["", f"%{name}_some = icmp sgt i64 %{name}_lanes, 0",
                       f"br i1 %{name}_some, label %{name}_turn, label %{name}_done"]
        self.begin(f"{name}_turn")
        self.write(operation.operations)
        # Count the rays, and go on with the lanes that do.
        sum_of_rays = self.line(f"load i64, ptr {cast}, align 8")
        for span in operation.rays:
            sum_of_rays = self.line(f"add i64 {sum_of_rays}, {self.number_of(span)}")
        self.lines.append(f"store i64 {sum_of_rays}, ptr {cast}, align 8")
        left = self.number_of(operation.left)
        size = self.line(f"mul i64 {left}, {operation.rest.size}")
        rest = self.address(operation.rest)
        self.lines += [f"call void @llvm.memcpy.p0.p0.i64(ptr {lanes}, ptr {rest}, i64 {size}, i1 false)",
                       f"br label %{name}"]
        self.lines[turn] = f"%{name}_lanes = phi i64 [ {start}, %{entered} ], [ {left}, %{self.block} ]"
        self.begin(f"{name}_done")
        # What was computed in a turn is not there afterwards.
        self.addresses = before | {operation.lanes: lanes}
        self.counts = {**dict.fromkeys(self.counts, "0"), **outer}
        self.counts[operation.cast] = self.line(f"load i64, ptr {cast}, align 8")

    def text(self) -> str:
        """The finished LLVM module."""
        loads, names = [], ("count", "count_rest", "begin", "put", "put_rest")
        for name, function in zip(names, ("count_abreast_i32", "count_rest_i32", "begin", "partition_abreast_i32",
                                          "partition_rest_i32")):
            self.functions.append(cpu_order.addresses()[function])
            loads += [f"%{name}_at = getelementptr ptr, ptr %functions, i64 {len(self.functions) - 1}",
                      f"%{name} = load ptr, ptr %{name}_at, align 8"]
        parts: list[list[Operation]] = [[]]
        for operation in self.recording.operations:
            if isinstance(operation, Outside):
                parts.append([])
            else:
                parts[-1].append(operation)
        functions = [self.part(number, operations) for number, operations in enumerate(parts)]
        abreast = cpu_order.ABREAST
        helpers = PARTITION.format(bytes=8 * abreast, abreast=abreast, before=8 * (abreast - 1), loads="\n  ".join(loads))
        return "".join([*functions, helpers])

    def part(self, number: int, operations: Sequence[Operation]) -> str:
        """The LLVM IR of the function, with this number, that does some consecutive operations."""
        self.lines, self.arrays, self.block, self.addresses, known = [], [], "entry", {}, len(self.counts)
        for count in range(2, known):
            at = self.line(f"getelementptr i64, ptr %counts, i64 {count}")
            self.counts[count] = self.line(f"load i64, ptr {at}, align 8")
        self.write(operations)
        for count in range(known, len(self.counts)):
            at = self.line(f"getelementptr i64, ptr %counts, i64 {count}")
            self.lines.append(f"store i64 {self.counts[count]}, ptr {at}, align 8")
        body = "\n".join(f"  {line}" for line in (*self.arrays, *self.lines))
        return f"{HEAD.format(number=number)}\n{body}\n  ret void\n}}\n"

    def write(self, operations: Sequence[Operation]) -> None:
        """Emits operations, in turn."""
        write = {RecordedLoop: self.loop, Partition: self.partition, Chosen: self.chosen, Put: self.put,
                 Inverted: self.inverted, Copy: self.copy, Scattered: self.scattered, Repeated: self.repeated}
        for operation in operations:
            write[type(operation)](operation)
