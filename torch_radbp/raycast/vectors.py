"""`Vectors`: writes an LLVM IR function over vectors of lanes, instruction by instruction."""

from __future__ import annotations

import struct

from torch_radbp.jit.cpu.machine import host_features
from torch_radbp.jit.lane.loops import FEW_LANES, TAKE_PARTS

ZERO = "zeroinitializer"
SIZES = {"i8": 1, "i32": 4, "float": 4, "double": 8}
SUFFIXES = {"float": "f32", "double": "f64"}


class Vectors:
    """The LLVM IR of `void lanes(i64 first, i64 last, ptr inputs, ptr outputs)`; every method appends instructions.

    Methods that compute give the name of their result. Numbers are vectors of `scalar`, flags vectors of i1.

    Args:
        width: lanes in a vector; at least 2.
        scalar: "float" or "double".
    """

    def __init__(self, width: int, scalar: str):
        self.width, self.scalar = width, scalar
        self.numbers, self.integers, self.flags = self.vector(scalar), self.vector("i32"), self.vector("i1")
        self.lines: list[str] = []
        self.declared: dict[str, str] = {}

    def text(self) -> str:
        """The finished LLVM module, with a function `lanes_of_job` that runs a part of a `team.Job`."""
        head = "define internal void @lanes(i64 %first, i64 %last, ptr noalias %inputs, ptr noalias %outputs) {"
        parts = TAKE_PARTS.format(width=self.width)
        return "\n".join([parts, FEW_LANES, head, *self.lines, "}", *self.declared.values(), ""])

    def lay(self, *lines: str) -> None:
        """Appends labels and instructions that name their results themselves."""
        self.lines += lines

    def line(self, text: str) -> str:
        """Appends an instruction and returns the name of its result."""
        name = f"%x{len(self.lines)}"
        self.lines.append(f"{name} = {text}")
        return name

    def call(self, function: str, result: str, *arguments: tuple[str, str]) -> str:
        """Calls an LLVM intrinsic; arguments are pairs of type and name. Returns no name if the result is void."""
        self.declared[function] = f"declare {result} @{function}({', '.join(kind for kind, _ in arguments)})"
        text = f"call {result} @{function}({', '.join(f'{kind} {name}' for kind, name in arguments)})"
        if result != "void":
            return self.line(text)
        self.lay(text)
        return ""

    # -- Types and constants --------------------------------------------------------------------------------------------

    def vector(self, kind: str) -> str:
        return f"<{self.width} x {kind}>"

    def suffix(self, kind: str) -> str:
        """The suffix of the names of LLVM's intrinsics for vectors of a type."""
        return f"v{self.width}{SUFFIXES.get(kind, kind)}"

    def constant(self, number: str) -> str:
        return f"splat ({self.scalar} {number})"

    def number(self, value: float) -> str:
        """The vector constant of the number nearest to `value`, in all lanes."""
        held = struct.unpack("f", struct.pack("f", value))[0] if self.scalar == "float" else value
        return self.constant(f"0x{struct.pack('>d', held).hex().upper()}")

    def steps(self, kind: str) -> str:
        """The constant vector 0, 1, 2, ... of a type."""
        return "<" + ", ".join(f"{kind} {lane}" for lane in range(self.width)) + ">"

    def counted(self, first: str) -> str:
        """Consecutive i32, one per lane, that start at an i64."""
        first = self.line(f"trunc i64 {first} to i32")
        return self.line(f"add {self.integers} {self.steps('i32')}, {self.splat(first, 'i32')}")

    def splat(self, name: str, kind: str) -> str:
        """Broadcasts one value to every lane."""
        vector = self.vector(kind)
        first = self.line(f"insertelement {vector} poison, {kind} {name}, i32 0")
        return self.line(f"shufflevector {vector} {first}, {vector} poison, {self.integers} {ZERO}")

    # -- Arithmetic -----------------------------------------------------------------------------------------------------

    def add(self, a: str, b: str) -> str:
        """Adds two vectors; LLVM may contract a product and a sum to one instruction, as for `sub` and `mul`."""
        return self.line(f"fadd contract {self.numbers} {a}, {b}")

    def sub(self, a: str, b: str) -> str:
        return self.line(f"fsub contract {self.numbers} {a}, {b}")

    def mul(self, a: str, b: str) -> str:
        return self.line(f"fmul contract {self.numbers} {a}, {b}")

    def dot(self, a: list[str], b: list[str]) -> str:
        return self.add(self.mul(a[2], b[2]), self.add(self.mul(a[1], b[1]), self.mul(a[0], b[0])))

    def determinant(self, a: list[str], b: list[str]) -> str:
        """a[0] b[1] - a[1] b[0], of the right sign, and 0 only if it is: within two roundings of the result.

        Reference: Jeannerod, Louvet and Muller 2013, "Further analysis of Kahan's algorithm for the accurate computation of
        2 x 2 determinants".
        """
        product = self.line(f"fmul {self.numbers} {a[1]}, {b[0]}")
        error = self.fused(self.negative(a[1]), b[0], product)
        return self.line(f"fadd {self.numbers} {self.fused(a[0], b[1], self.negative(product))}, {error}")

    def fused(self, a: str, b: str, c: str) -> str:
        """Fused multiply-add, a b + c, rounded once."""
        arguments = ((self.numbers, name) for name in (a, b, c))
        return self.call(f"llvm.fma.{self.suffix(self.scalar)}", self.numbers, *arguments)

    def div(self, a: str, b: str) -> str:
        return self.line(f"fdiv {self.numbers} {a}, {b}")

    def negative(self, a: str) -> str:
        return self.line(f"fneg {self.numbers} {a}")

    def magnitude(self, a: str) -> str:
        return self.call(f"llvm.fabs.{self.suffix(self.scalar)}", self.numbers, (self.numbers, a))

    def negated_where_negative(self, a: str, b: str) -> str:
        """`a` times the sign of `b`."""
        words = self.vector("i32" if self.scalar == "float" else "i64")
        sign = f"splat ({words[1:-1].split()[-1]} {-1 << 31 if self.scalar == 'float' else -1 << 63})"
        a, b = (self.line(f"bitcast {self.numbers} {name} to {words}") for name in (a, b))
        signed = self.line(f"xor {words} {a}, {self.line(f'and {words} {b}, {sign}')}")
        return self.line(f"bitcast {words} {signed} to {self.numbers}")

    # -- Decisions ------------------------------------------------------------------------------------------------------

    def compare(self, a: str, relation: str, b: str) -> str:
        """Compares two vectors; LLVM's relations with an "o" in front are false for NaN."""
        return self.line(f"fcmp {relation} {self.numbers} {a}, {b}")

    def both(self, a: str, b: str) -> str:
        return self.line(f"and {self.flags} {a}, {b}")

    def either(self, a: str, b: str) -> str:
        return self.line(f"or {self.flags} {a}, {b}")

    def neither(self, a: str, b: str) -> str:
        return self.line(f"xor {self.flags} {self.either(a, b)}, splat (i1 true)")

    def choose(self, flags: str, a: str, b: str, kind: str = "") -> str:
        """Selects `a` where the flags are set, else `b`; vectors of `kind`, numbers unless it is given."""
        vector = self.vector(kind or self.scalar)
        return self.line(f"select {self.flags} {flags}, {vector} {a}, {vector} {b}")

    def lesser(self, a: str, b: str) -> str:
        """The lesser of two numbers, `b` if one is NaN; as is `greater`."""
        return self.choose(self.compare(a, "olt", b), a, b)

    def greater(self, a: str, b: str) -> str:
        return self.choose(self.compare(a, "ogt", b), a, b)

    def count(self, flags: str) -> str:
        """The number of flags that are set, i64."""
        return self.call("llvm.ctpop.i64", "i64", ("i64", self.bits(flags)))

    def compressed(self, integers: str, flags: str) -> str:
        """Moves the i32 whose flags are set to the front, in their order."""
        return self.call(f"llvm.experimental.vector.compress.{self.suffix('i32')}", self.integers, (self.integers, integers),
                         (self.flags, flags), (self.integers, ZERO))

    def bits(self, flags: str) -> str:
        """Packs the flags into an i64, lane 0 in its lowest bit."""
        packed = self.line(f"bitcast {self.flags} {flags} to i{self.width}")
        return self.line(f"zext i{self.width} {packed} to i64")

    # -- Memory ---------------------------------------------------------------------------------------------------------

    def at(self, kind: str, base: str, index: str | int) -> str:
        """The address of an entry of an array."""
        return self.line(f"getelementptr {kind}, ptr {base}, i64 {index}")

    def load(self, kind: str, base: str, index: str | int = 0) -> str:
        """Loads one entry of an array, as a scalar."""
        return self.line(f"load {kind}, ptr {self.at(kind, base, index)}")

    def store(self, vector: str, value: str, address: str) -> None:
        self.lay(f"store {vector} {value}, ptr {address}")

    def load_where(self, mask: str, base: str, index: str) -> str:
        """Loads consecutive numbers from `index` on; 0 in lanes where the mask is not set."""
        return self.call(f"llvm.masked.load.{self.suffix(self.scalar)}.p0", self.numbers,
                         ("ptr", self.at(self.scalar, base, index)), ("i32", str(SIZES[self.scalar])), (self.flags, mask),
                         (self.numbers, ZERO))

    def store_where(self, mask: str, kind: str, value: str, base: str, index: str) -> None:
        """Stores consecutive values from `index` on in lanes where the mask is set."""
        self.call(f"llvm.masked.store.{self.suffix(kind)}.p0", "void", (self.vector(kind), value),
                  ("ptr", self.at(kind, base, index)), ("i32", str(SIZES[kind])), (self.flags, mask))

    def gather(self, kind: str, base: str, indices: str, mask: str = "splat (i1 true)") -> str:
        """Gathers entries of an array at i32 indices; 0 where the mask is not set."""
        places = self.line(f"getelementptr {kind}, ptr {base}, {self.integers} {indices}")
        return self.call(f"llvm.masked.gather.{self.suffix(kind)}.v{self.width}p0", self.vector(kind),
                         (self.vector("ptr"), places), ("i32", str(SIZES[kind])), (self.flags, mask),
                         (self.vector(kind), ZERO))

    @property
    def permutes(self) -> bool:
        """True if the processor can permute elements of these vectors by index (AVX-512)."""
        return self.width == 16 and self.scalar == "float" and bool(host_features().get("avx512f"))

    def permuted(self, base: str, indices: str, entries: int) -> str:
        """Looks up entries of an array of 32 or 64 entries at i32 indices, by permuting registers."""
        function = "llvm.x86.avx512.vpermi2var.ps.512"
        parts = [self.line(f"load {self.numbers}, ptr {self.at(self.scalar, base, first)}, align 4")
                 for first in range(0, entries, self.width)]
        halves = [self.call(function, self.numbers, (self.numbers, low), (self.integers, indices), (self.numbers, high))
                  for low, high in zip(parts[::2], parts[1::2])]
        if len(halves) == 1:
            return halves[0]
        beyond = self.line(f"icmp ugt {self.integers} {indices}, splat (i32 {2 * self.width - 1})")
        return self.choose(beyond, halves[1], halves[0])

    def scatter(self, kind: str, value: str, base: str, indices: str, mask: str) -> None:
        """Scatters values to i32 indices of an array where the mask is set."""
        places = self.line(f"getelementptr {kind}, ptr {base}, {self.integers} {indices}")
        self.call(f"llvm.masked.scatter.{self.suffix(kind)}.v{self.width}p0", "void", (self.vector(kind), value),
                  (self.vector("ptr"), places), ("i32", str(SIZES[kind])), (self.flags, mask))
