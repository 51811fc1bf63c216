"""Look-ups of tables whose entries lie close together, by permuting vector registers.

A gather takes a turn for every lane. But the lanes of a block often read few places, and many tables at each: paths that go
on are neighbours in memory, tables of lamps and of materials are short, neighbouring pixels see the same triangles. So a
block looks whether all lanes of an index lie within a window of two vectors. If they do, the window is loaded of each table
that is read there, and permuted. What is read is the same either way.

Reference: Intel 64 and IA-32 Architectures Software Developer's Manual, VPERMI2D (AVX-512) and VPERMD (AVX2).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import torch

from torch_radbp.jit.lane.graph import LANES, Program, Value
from torch_radbp.jit.lane.instructions import SCALARS, memory


class TableWindow(NamedTuple):
    """A window: consecutive entries of a table that fill two vector registers, which a processor permutes as one."""

    elements: int  # 4-byte elements in each
    reads_bytes: bool  # masked loads of bytes exist, so that tables of bools can be read, too

    def fits(self, width: int) -> bool:
        """True if blocks of `width` lanes are whole vectors."""
        return width % self.elements == 0

    def reads(self, value: Value) -> bool:
        """True for a table look-up whose entries may be taken from a window: of 4 bytes each, or bools."""
        table, index = value.arguments if value.operation == "gather" else (None, None)
        return table is not None and table.operation == "input" and index.kind == LANES and (
            table.dtype in (torch.float32, torch.int32) or (table.dtype == torch.bool and self.reads_bytes))


def window_of(features: Mapping[str, bool]) -> TableWindow | None:
    """The size of a window, part of a table in two registers, by instruction sets; None: the processor permutes no two."""
    if features.get("avx512f"):
        return TableWindow(16, bool(features.get("avx512bw")))
    return TableWindow(8, False) if features.get("avx2") else None


def at_one_index(program: Program, window: TableWindow | None) -> dict[Value, list[Value]]:
    """Groups the look-ups of several tables at one index, which a window, a part of each table in two vector registers, may
    serve; by index, without single ones."""
    found: dict[Value, list[Value]] = {}
    for value in program.values if window is not None else ():
        if window.reads(value) and program.column(value.arguments[0]) is None:
            found.setdefault(value.arguments[1], []).append(value)
    return {index: gathers for index, gathers in found.items() if len(gathers) > 1}


class WindowReading:
    """Emits look-ups of several tables at one index: where all lanes read within a window, as many consecutive entries as
    two vector registers hold, it is loaded of each table and permuted; elsewhere entries are gathered.

    Args:
        emitter: of the program, which gathers what is not in the window.
        window: of the processor.
        index: name of the block of indices.
        scalar: LLVM's name of their type.
    """

    def __init__(self, emitter, window: TableWindow, index: str, scalar: str):
        self.emitter, self.window, self.index, self.scalar = emitter, window, index, scalar

    def emit(self, gathers: Sequence[Value]) -> list[str]:
        """Emits the instructions of gathers at this index, and returns the names of their results."""
        emitter, number = self.emitter, len(self.emitter.body)
        near, far, read = f"near{number}", f"far{number}", f"read{number}"
        base, offset, within = self.place()
        emitter.body += [f"br i1 {within}, label %{near}, label %{far}", f"{near}:"]
        permuted = self.permuted(gathers, base, offset)
        emitter.body += [f"br label %{read}", f"{far}:"]
        gathered = [emitter.gather(value) for value in gathers]
        emitter.body += [f"br label %{read}", f"{read}:"]
        return [emitter.line(f"phi {emitter.vector(SCALARS[value.dtype])} [ {one}, %{near} ], [ {other}, %{far} ]")
                for value, one, other in zip(gathers, permuted, gathered)]

    def place(self) -> tuple[str, str, str]:
        """Emits the window's first entry, i64, each lane's offset in it, i32, and whether all lanes are inside."""
        line, vector, scalar = self.emitter.line, self.emitter.vector, self.scalar
        base = self.reduced("smin", scalar, self.index)
        offset = line(f"sub {vector(scalar)} {self.index}, {self.everywhere(self.emitter.width, scalar, base)}")
        inside = line(f"icmp ult {vector(scalar)} {offset}, splat ({scalar} {2 * self.window.elements})")
        within = self.reduced("and", "i1", inside)
        if scalar == "i64":
            return base, line(f"trunc {vector('i64')} {offset} to {vector('i32')}"), within
        return line(f"sext i32 {base} to i64"), offset, within

    def reduced(self, operation: str, scalar: str, vector: str) -> str:
        """Emits a reduction of all lanes to one number."""
        kind, function = self.emitter.vector(scalar), f"llvm.vector.reduce.{operation}.{self.emitter.suffix(scalar)}"
        self.emitter.declared[function] = f"declare {scalar} @{function}({kind})"
        return self.emitter.line(f"call {scalar} @{function}({kind} {vector})")

    def everywhere(self, elements: int, scalar: str, number: str) -> str:
        """Emits a vector whose elements all are `number`."""
        kind = f"<{elements} x {scalar}>"
        first = self.emitter.line(f"insertelement {kind} poison, {scalar} {number}, i32 0")
        return self.emitter.line(f"shufflevector {kind} {first}, {kind} poison, <{elements} x i32> zeroinitializer")

    def permuted(self, gathers: Sequence[Value], base: str, offset: str) -> list[str]:
        """Emits the permutation of the window that begins at `base`."""
        elements, line = self.window.elements, self.emitter.line
        left = line(f"sub i64 {self.entries(gathers)}, {base}")
        few = line(f"icmp slt i64 {left}, {2 * elements}")
        left = line(f"select i1 {few}, i64 {left}, i64 {2 * elements}")
        left = self.everywhere(elements, "i32", line(f"trunc i64 {left} to i32"))
        kind = f"<{elements} x i32>"
        masks = [line(f"icmp ult {kind} <{', '.join(f'i32 {first + place}' for place in range(elements))}>, {left}")
                 for first in (0, elements)]
        parts = [offset] if self.emitter.width == elements else [
            line(f"shufflevector {self.emitter.vector('i32')} {offset}, {self.emitter.vector('i32')} poison, "
                 f"{kind} <{', '.join(f'i32 {first + place}' for place in range(elements))}>")
            for first in range(0, self.emitter.width, elements)]
        return [self.entries_in(value, base, masks, parts) for value in gathers]

    def entries(self, gathers: Sequence[Value]) -> str:
        """Emits the least length of all the tables, i64."""
        inputs, least = self.emitter.program.inputs, ""
        for number in sorted({inputs.index(value.arguments[0]) for value in gathers}):
            length = self.emitter.length(number)
            if least:
                fewer = self.emitter.line(f"icmp slt i64 {length}, {least}", self.emitter.entry)
                length = self.emitter.line(f"select i1 {fewer}, i64 {length}, i64 {least}", self.emitter.entry)
            least = length
        return least

    def entries_in(self, value: Value, base: str, masks: Sequence[str], parts: Sequence[str]) -> str:
        """Emits the look-up of one table; `parts`: the lanes' offsets in the window, vector by vector."""
        elements, line, scalar = self.window.elements, self.emitter.line, memory(value.dtype)
        kind, table = f"<{elements} x i32>", self.emitter.names[value.arguments[0]]
        first = line(f"getelementptr {scalar}, ptr {table}, i64 {base}")
        places = first, line(f"getelementptr {scalar}, ptr {first}, i64 {elements}")
        low, high = (self.loaded("i8" if scalar == "i8" else "i32", place, mask) for place, mask in zip(places, masks))
        found = [self.chosen(kind, low, high, part) for part in parts]
        joined = found[0]
        for part in found[1:]:
            assert len(found) == 2, "blocks are of one vector or two"
            joined = line(f"shufflevector {kind} {joined}, {kind} {part}, <{2 * elements} x i32> "
                          f"<{', '.join(f'i32 {place}' for place in range(2 * elements))}>")
        whole = self.emitter.vector("i32")
        if scalar == "i8":
            return line(f"icmp ne {whole} {joined}, zeroinitializer")
        return joined if scalar == "i32" else line(f"bitcast {whole} {joined} to {self.emitter.vector(scalar)}")

    def loaded(self, scalar: str, place: str, mask: str) -> str:
        """Emits the load of a vector of the window as i32, masked beyond the table's end."""
        elements, size = self.window.elements, 1 if scalar == "i8" else 4
        kind, function = f"<{elements} x {scalar}>", f"llvm.masked.load.v{elements}{scalar}.p0"
        self.emitter.declared[function] = f"declare {kind} @{function}(ptr, i32, <{elements} x i1>, {kind})"
        found = self.emitter.line(f"call {kind} @{function}(ptr {place}, i32 {size}, <{elements} x i1> {mask}, {kind} "
                                  "zeroinitializer)")
        return found if scalar == "i32" else self.emitter.line(f"zext {kind} {found} to <{elements} x i32>")

    def chosen(self, kind: str, low: str, high: str, places: str) -> str:
        """Emits the selection of elements from the two vectors of a window."""
        line, declared = self.emitter.line, self.emitter.declared
        if self.window.elements == 16:
            function = "llvm.x86.avx512.vpermi2var.d.512"
            declared[function] = f"declare {kind} @{function}({kind}, {kind}, {kind})"
            return line(f"call {kind} @{function}({kind} {low}, {kind} {places}, {kind} {high})")
        function = "llvm.x86.avx2.permd"
        declared[function] = f"declare {kind} @{function}({kind}, {kind})"
        found = [line(f"call {kind} @{function}({kind} {half}, {kind} {places})") for half in (low, high)]
        beyond = line(f"icmp ugt {kind} {places}, splat (i32 {self.window.elements - 1})")
        return line(f"select <{self.window.elements} x i1> {beyond}, {kind} {found[1]}, {kind} {found[0]}")
