"""Emits LLVM IR from a program: the instructions for a block of W lanes.

They are of vectors of W lanes or, for W = 1, of scalars. What stands around them is the target's: a loop over blocks on a
processor (`cpu/cpu.py`), a lane for each thread on a GPU (`nvidia/nvptx.py`). It defines `%i`, the first lane of the block,
the pointers `%in0`, `%in1`, ... to the inputs and `%out0`, ... to the outputs, and `%length<k>`, the number of entries of an
input that is searched. Every tensor lies at a multiple of its element's size (`jit/arguments.py` sees to it), which GPUs
demand: what may lie anywhere they read byte by byte.

What is computed from numbers alone stands before the loop. No processor gathers bytes: of a table of bools the aligned words
are read that the entries lie in. Nor does one divide vectors of integers: int32 are divided as float64, which is exact.

Nearly every operation is one line of a table of `instructions.py`. Compilers may take no liberties with floating point:
infinities, NaN and signs of zeros are as in torch, and which products are fused with sums is said by `fused.py`.

Reference: LLVM Language Reference Manual.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch

from torch_radbp.jit.lane.fused import FusedSum, fused_sums
from torch_radbp.jit.lane.graph import LANES, NUMBER, TABLE, Program, Value
from torch_radbp.jit.lane.instructions import (
    BOOLEAN,
    FLOATING,
    INTEGER,
    INTEGERS,
    INTRINSICS,
    LIBRARY,
    SCALARS,
    SUFFIXES,
    alignment,
    literal,
    memory,
    scalar_suffix,
)
from torch_radbp.jit.lane.loops import SEARCH
from torch_radbp.jit.lane.repeated import RepeatedText
from torch_radbp.jit.lane.row_reads import RowReading, in_rows
from torch_radbp.jit.lane.schedule import few_alive
from torch_radbp.jit.lane.window import TableWindow, WindowReading, at_one_index


class Body(NamedTuple):
    """The LLVM IR of a program for one block of lanes."""

    program: Program
    before: list[str]  # executed once, before the first block
    block: list[str]
    functions: tuple[str, ...]  # functions that are called, defined or declared
    names: dict[Value, str]  # of all values


class ProgramText:
    """Emits one program for blocks of lanes.

    Args:
        program: what is computed.
        width: lanes of a block; 1: scalar.
        window: for table entries that may lie close together.
        fuses: products are fused with sums.
    """

    def __init__(self, program: Program, width: int, window: TableWindow | None = None, fuses: bool = True):
        self.program, self.width = program, width
        self.sums, self.within = fused_sums(program) if fuses else ({}, set())
        self.window = window if window is not None and window.fits(width) else None
        self.near = at_one_index(program, self.window)  # gathers that are read together
        self.rows = in_rows(program, width)
        self.entry: list[str] = []  # before the loop
        self.body: list[str] = []
        self.here = self.body  # where the value that is emitted now is computed
        self.declared: dict[str, str] = {}
        self.names: dict[Value, str] = {}

    def instructions(self) -> Body:
        """Emits all instructions of the program."""
        if self.program.repetition is not None:
            return RepeatedText(self, self.program.repetition).instructions()
        waiting: dict[Value, list[int]] = {}  # the outputs that each value is
        for number, value in enumerate(value for value in self.program.outputs if value is not None):
            waiting.setdefault(value, []).append(number)
        for value in (few_alive if self.width == 1 else gathers_first)(self.program.values):
            self.here = self.entry if value.kind == NUMBER else self.body
            if value in self.names or value in self.within:  # read, or computed, together with another
                continue
            self.names[value] = self.emit(value)
            if self.width == 1 and value.kind == LANES:  # a thread has no register to spare for what is done
                self.store(value, waiting.pop(value, ()))
        for value, numbers in waiting.items():
            self.store(value, numbers)
        return self.text()

    def text(self) -> Body:
        """The LLVM IR emitted so far."""
        return Body(self.program, self.entry, self.body, tuple(self.declared.values()), self.names)

    # -- Types and constants --------------------------------------------------------------------------------------------

    def vector(self, scalar: str) -> str:
        """The LLVM type of a block of lanes."""
        return scalar if self.width == 1 else f"<{self.width} x {scalar}>"

    def suffix(self, name: str) -> str:
        """The suffix of LLVM intrinsics' names for a block of lanes."""
        return name if self.width == 1 else f"v{self.width}{name}"

    def everywhere(self, scalar: str, literal: str) -> str:
        """The LLVM constant of a block whose lanes all are `literal`."""
        return literal if self.width == 1 else f"splat ({scalar} {literal})"

    def constant(self, value: Value) -> str:
        """Emits a constant of the program."""
        return self.everywhere(SCALARS[value.dtype], literal(value.static, value.dtype))

    # -- Values ---------------------------------------------------------------------------------------------------------

    def line(self, text: str, lines: list[str] | None = None) -> str:
        """Appends an instruction and returns the name of its result."""
        lines = self.here if lines is None else lines
        name = f"%{'e' if lines is self.entry else 'b'}{len(lines)}"
        lines.append(f"{name} = {text}")
        return name

    def emit(self, value: Value) -> str:
        """Emits the instructions that compute a value, and returns its name."""
        operation, dtype = value.operation, value.dtype
        if operation == "constant":
            return self.constant(value)
        if operation == "input":
            return self.load(value)
        if value in self.sums:
            return self.fused(self.sums[value], dtype)
        names = [self.names[argument] for argument in value.arguments]
        if operation == "gather":
            return self.read(value)
        if operation == "search":
            return self.search(value)
        working = value.arguments[-1].dtype  # of the operands; of a comparison the result is bool
        types = {"T": self.vector(SCALARS[working])}
        if operation == "select":
            condition = self.vector("i1")
            return self.line(f"select {condition} {names[0]}, {types['T']} {names[1]}, {types['T']} {names[2]}")
        if operation == "cast":
            return self.cast(names[0], working, dtype)
        if operation == "bitcast":
            return self.line(f"bitcast {types['T']} {names[0]} to {self.vector(SCALARS[dtype])}")
        if operation == "not":
            return self.line(f"xor {types['T']} {names[0]}, {self.everywhere(SCALARS[working], literal(-1, working))}")
        if operation == "abs" and working in INTEGERS:
            return self.call(f"llvm.abs.{self.suffix(SUFFIXES[working])}", working, names, ", i1 false")
        if operation in ("div", "rem") and working == torch.int32 and (
                self.width > 1 or value.arguments[1].operation != "constant"):
            return self.divided(*names, remainder=operation == "rem")
        table = FLOATING if working not in INTEGERS else INTEGER | (BOOLEAN if working == torch.bool else {})
        if operation in table:
            return self.line(table[operation].format(*names, **types))
        if operation in INTRINSICS and working not in INTEGERS:
            return self.call(f"llvm.{INTRINSICS[operation]}.{self.suffix(SUFFIXES[working])}", working, names)
        if operation in LIBRARY and working == torch.float64:
            return self.lane_by_lane(operation, names)
        raise NotImplementedError(f"{value!r} has no instruction")

    def fused(self, found: FusedSum, dtype: torch.dtype) -> str:
        """Emits a sum of a product and a term, rounded once."""
        kind = self.vector(SCALARS[dtype])
        (first, second), term = (self.names[factor] for factor in found.product.arguments), self.names[found.term]
        if found.negative_product:
            first = self.line(f"fneg {kind} {first}")
        if found.negative_term:
            term = self.line(f"fneg {kind} {term}")
        return self.call(f"llvm.fma.{self.suffix(SUFFIXES[dtype])}", dtype, [first, second, term])

    def call(self, function: str, dtype: torch.dtype, names: list[str], more: str = "") -> str:
        """Emits a call of an LLVM function of whole blocks of lanes."""
        kind = self.vector(SCALARS[dtype])
        parameters = ", ".join([kind] * len(names)) + (", i1" if more else "")
        self.declared[function] = f"declare {kind} @{function}({parameters})"
        return self.line(f"call {kind} @{function}({', '.join(f'{kind} {name}' for name in names)}{more})")

    def divided(self, a: str, b: str, remainder: bool) -> str:
        """The quotient of int32, truncated, or the remainder, exactly: by float64, since vectors cannot divide integers.

        The quotient differs from the next integer by at least 1 / b, far more than float64 rounds off. Where the divisor is
        zero the result is some integer.
        """
        whole, wide = self.vector("i32"), self.vector("double")
        left, right = (self.line(f"sitofp {whole} {name} to {wide}") for name in (a, b))
        quotient = self.line(f"fdiv {wide} {left}, {right}")
        quotient = self.line(f"freeze {whole} " + self.line(f"fptosi {wide} {quotient} to {whole}"))
        if not remainder:
            return quotient
        product = self.line(f"mul {whole} {quotient}, {b}")
        return self.line(f"sub {whole} {a}, {product}")

    def lane_by_lane(self, function: str, names: list[str]) -> str:
        """Emits calls of a function of the C library, one per lane."""
        self.declared[function] = f"declare double @{function}({', '.join(['double'] * len(names))})"
        if self.width == 1:
            return self.line(f"call double @{function}({', '.join(f'double {name}' for name in names)})")
        kind, result = self.vector("double"), "poison"
        for lane in range(self.width):
            parts = [self.line(f"extractelement {kind} {name}, i32 {lane}") for name in names]
            answer = self.line(f"call double @{function}({', '.join(f'double {part}' for part in parts)})")
            result = self.line(f"insertelement {kind} {result}, double {answer}, i32 {lane}")
        return result

    def cast(self, name: str, have: torch.dtype, want: torch.dtype) -> str:
        """Emits a conversion as `Tensor.to` makes it; a float beyond an integer's range gives any integer."""
        source, target = self.vector(SCALARS[have]), self.vector(SCALARS[want])
        if want == torch.bool:
            zero = "zeroinitializer" if self.width > 1 else literal(0, have)
            return self.line(f"{'icmp ne' if have in INTEGERS else 'fcmp une'} {source} {name}, {zero}")
        if have in INTEGERS and want in INTEGERS:
            word = "zext" if have == torch.bool else "sext" if want == torch.int64 else "trunc"
            return self.line(f"{word} {source} {name} to {target}")
        if have in INTEGERS:
            return self.line(f"{'uitofp' if have == torch.bool else 'sitofp'} {source} {name} to {target}")
        if want in INTEGERS:
            return self.line(f"freeze {target} " + self.line(f"fptosi {source} {name} to {target}"))
        return self.line(f"{'fpext' if want == torch.float64 else 'fptrunc'} {source} {name} to {target}")

    # -- Memory ---------------------------------------------------------------------------------------------------------

    def load(self, value: Value) -> str:
        """Emits the load of an input: a table's pointer, a number in every lane, or the block of lanes."""
        number, scalar = self.program.inputs.index(value), SCALARS[value.dtype]
        pointer = f"%in{number}"
        if value.kind == TABLE:
            return pointer
        if value.kind == NUMBER:
            loaded = self.line(f"load {memory(value.dtype)}, ptr {pointer}, align {alignment(value.dtype)}")
            if value.dtype == torch.bool:
                loaded = self.line(f"trunc i8 {loaded} to i1")
            if self.width == 1:
                return loaded
            vector = self.vector(scalar)
            first = self.line(f"insertelement {vector} poison, {scalar} {loaded}, i32 0")
            return self.line(f"shufflevector {vector} {first}, {vector} poison, <{self.width} x i32> zeroinitializer")
        kind = self.vector(memory(value.dtype))
        place = self.line(f"getelementptr {memory(value.dtype)}, ptr {pointer}, i64 %i")
        loaded = self.line(f"load {kind}, ptr {place}, align {alignment(value.dtype)}")
        return self.line(f"trunc {kind} {loaded} to {self.vector('i1')}") if value.dtype == torch.bool else loaded

    def read(self, value: Value) -> str:
        """Emits a table look-up, together with others at the same index."""
        table, index = value.arguments
        column, place = self.program.column(table), (self.names[index], SCALARS[index.dtype])
        gathers = self.near.get(index, ()) if column is None else self.rows.get((index, column.block), ())
        if value not in gathers:
            return self.gather(value)
        self.names |= {gather.arguments[0]: self.load(gather.arguments[0]) for gather in gathers}
        reading = WindowReading(self, self.window, *place) if column is None else RowReading(self, *place)
        self.names |= zip(gathers, reading.emit(gathers))
        return self.names[value]

    def length(self, number: int) -> str:
        """Emits the load of the number of entries of an input, i64."""
        place = self.line(f"getelementptr i64, ptr %inputs, i64 {len(self.program.inputs) + number}", self.entry)
        return self.line(f"load i64, ptr {place}, align 8", self.entry)

    def gather(self, value: Value) -> str:
        """Emits a gather: base and 32-bit index, one instruction where the processor has one."""
        table, index = value.arguments
        at, column = self.names[index], self.program.column(table)
        if column is not None:
            at = self.line(f"mul {self.vector(SCALARS[index.dtype])} {at}, "
                           f"{self.everywhere(SCALARS[index.dtype], str(column.width))}")
        if self.width == 1:
            scalar = memory(table.dtype)
            place = self.line(f"getelementptr {scalar}, ptr {self.names[table]}, {SCALARS[index.dtype]} {at}")
            entry = self.line(f"load {scalar}, ptr {place}, align {alignment(table.dtype)}")
            return self.line(f"trunc i8 {entry} to i1") if table.dtype == torch.bool else entry
        if table.dtype == torch.bool:
            return self.gather_bits(self.names[table], at, SCALARS[index.dtype])
        return self.gather_words(SCALARS[table.dtype], self.names[table], at, SCALARS[index.dtype])

    def gather_words(self, scalar: str, table: str, index: str, index_scalar: str) -> str:
        """Emits a gather from a table with entries of 4 or 8 bytes."""
        kind, pointers, flags = self.vector(scalar), self.vector("ptr"), self.vector("i1")
        places = self.line(f"getelementptr {scalar}, ptr {table}, {self.vector(index_scalar)} {index}")
        function = f"llvm.masked.gather.{self.suffix(scalar_suffix(scalar))}.{self.suffix('p0')}"
        self.declared[function] = f"declare {kind} @{function}({pointers}, i32, {flags}, {kind})"
        size = 8 if scalar in ("double", "i64") else 4
        return self.line(f"call {kind} @{function}({pointers} {places}, i32 {size}, {flags} "
                         f"{self.everywhere('i1', 'true')}, {kind} poison)")

    def gather_bits(self, table: str, index: str, scalar: str) -> str:
        """Emits a gather from a table of bools, by the aligned words around these, which never cross a page."""
        kind, words = self.vector(scalar), self.vector("i32")
        address = self.line(f"ptrtoint ptr {table} to i64", self.entry)
        before = self.line(f"and i64 {address}, 3", self.entry)  # bytes in the first word that are not of the table
        start = self.line(f"getelementptr i8, ptr {table}, i64 " + self.line(f"sub i64 0, {before}", self.entry), self.entry)
        shift = before if scalar == "i64" else self.line(f"trunc i64 {before} to i32", self.entry)
        first = self.line(f"insertelement {kind} poison, {scalar} {shift}, i32 0", self.entry)
        shift = self.line(f"shufflevector {kind} {first}, {kind} poison, <{self.width} x i32> zeroinitializer", self.entry)
        byte = self.line(f"add {kind} {index}, {shift}")
        at = self.line(f"lshr {kind} {byte}, {self.everywhere(scalar, '2')}")
        word = self.gather_words("i32", start, at, scalar)
        in_word = self.line(f"and {kind} {byte}, {self.everywhere(scalar, '3')}")
        if scalar == "i64":
            in_word = self.line(f"trunc {kind} {in_word} to {words}")
        bits = self.line(f"shl {words} {in_word}, {self.everywhere('i32', '3')}")
        return self.line(f"trunc {words} " + self.line(f"lshr {words} {word}, {bits}") + f" to {self.vector('i1')}")

    def search(self, value: Value) -> str:
        """Emits a bisection: the number of entries of a sorted table that are at most the lane's number."""
        table, number = value.arguments
        length, scalar = f"%length{self.program.inputs.index(table)}", SCALARS[table.dtype]
        function = f"search_{scalar}"
        numbers, counts = self.vector(scalar), self.vector("i64")
        gather = f"llvm.masked.gather.{self.suffix(scalar_suffix(scalar))}.{self.suffix('p0')}"
        if self.width > 1:
            self.declared[gather] = f"declare {numbers} @{gather}({self.vector('ptr')}, i32, {self.vector('i1')}, {numbers})"
        read = (f"call {numbers} @{gather}({self.vector('ptr')} %places, i32 {table.dtype.itemsize}, {self.vector('i1')} "
                f"{self.everywhere('i1', 'true')}, {numbers} poison)" if self.width > 1
                else f"load {scalar}, ptr %places, align {table.dtype.itemsize}")
        self.declared[function] = SEARCH.format(
            function=function, numbers=numbers, counts=counts, places=self.vector("ptr"), scalar=scalar, read=read,
            flags=self.vector("i1"), one=self.everywhere("i64", "1"), zero=self.everywhere("i64", "0"),
            spread=self.spread("%half"))
        return self.line(f"call {counts} @{function}(ptr {self.names[table]}, i64 {length}, {numbers} {self.names[number]})")

    def spread(self, name: str) -> str:
        """The instructions that set `%step` to a vector with the i64 `name` in every lane."""
        if self.width == 1:
            return f"%step = add i64 {name}, 0"
        vector = self.vector("i64")
        return (f"%first = insertelement {vector} poison, i64 {name}, i32 0\n"
                f"  %step = shufflevector {vector} %first, {vector} poison, <{self.width} x i32> zeroinitializer")

    def store(self, value: Value, numbers: Sequence[int]) -> None:
        """Emits the store of a value's block of lanes into the outputs with these numbers."""
        kind, self.here = self.vector(memory(value.dtype)), self.body
        for number in numbers:
            name = self.names[value]
            if value.dtype == torch.bool:
                name = self.line(f"zext {self.vector('i1')} {name} to {kind}")
            place = self.line(f"getelementptr {memory(value.dtype)}, ptr %out{number}, i64 %i")
            self.body.append(f"store {kind} {name}, ptr {place}, align {alignment(value.dtype)}")


def gathers_first(values: Sequence[Value]) -> list[Value]:
    """Orders values with gathers as early as possible, each value after those that it is computed from.

    So the processor waits for many entries at a time, not for one after the other. For that, vectors are kept in memory; a
    thread of a GPU waits while others go on.
    """
    level: dict[Value, int] = {}  # how many gathers stand one after the other before a value
    needed: set[Value] = set()  # by gathers, themselves included
    for value in values:
        level[value] = max((level[argument] + (argument.operation == "gather") for argument in value.arguments), default=0)
    for value in reversed(values):
        if value.operation == "gather" or value in needed:
            needed.update((value, *value.arguments))
    return sorted((value for value in values if value in needed), key=level.__getitem__) + [
        value for value in values if value not in needed]


def emit(program: Program, width: int, window: TableWindow | None = None, fuses: bool = True) -> Body:
    """Emits the instructions of `program`. Args as for `ProgramText`."""
    return ProgramText(program, width, window, fuses).instructions()
