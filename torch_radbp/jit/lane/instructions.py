"""LLVM's instructions for the operations of `graph`, its types and constants.

{T} stands for the type of the operands, {0} and {1} for these.

Reference: LLVM Language Reference Manual.
"""

from __future__ import annotations

import struct

import torch

SCALARS = {torch.float32: "float", torch.float64: "double", torch.int32: "i32", torch.int64: "i64", torch.bool: "i1"}
SUFFIXES = {torch.float32: "f32", torch.float64: "f64", torch.int32: "i32", torch.int64: "i64", torch.bool: "i1"}
INTEGERS = (torch.bool, torch.int32, torch.int64)

FLOATING = {
    "neg": "fneg {T} {0}", "add": "fadd {T} {0}, {1}", "sub": "fsub {T} {0}, {1}",
    "mul": "fmul {T} {0}, {1}", "div": "fdiv {T} {0}, {1}", "rem": "frem {T} {0}, {1}",
    "eq": "fcmp oeq {T} {0}, {1}", "ne": "fcmp une {T} {0}, {1}", "lt": "fcmp olt {T} {0}, {1}",
    "le": "fcmp ole {T} {0}, {1}", "gt": "fcmp ogt {T} {0}, {1}", "ge": "fcmp oge {T} {0}, {1}",
}
INTEGER = {
    "neg": "sub {T} zeroinitializer, {0}", "add": "add {T} {0}, {1}", "sub": "sub {T} {0}, {1}", "mul": "mul {T} {0}, {1}",
    "div": "sdiv {T} {0}, {1}", "rem": "srem {T} {0}, {1}", "and": "and {T} {0}, {1}", "or": "or {T} {0}, {1}",
    "xor": "xor {T} {0}, {1}", "shl": "shl {T} {0}, {1}", "ashr": "ashr {T} {0}, {1}",
    "eq": "icmp eq {T} {0}, {1}", "ne": "icmp ne {T} {0}, {1}", "lt": "icmp slt {T} {0}, {1}",
    "le": "icmp sle {T} {0}, {1}", "gt": "icmp sgt {T} {0}, {1}", "ge": "icmp sge {T} {0}, {1}",
}
# Of bools, true is 1, so that their order is that of unsigned numbers.
BOOLEAN = {"lt": "icmp ult {T} {0}, {1}", "le": "icmp ule {T} {0}, {1}", "gt": "icmp ugt {T} {0}, {1}",
           "ge": "icmp uge {T} {0}, {1}"}
# LLVM's functions of vectors; those of the last two rows become calls of the C library, lane by lane.
INTRINSICS = {
    "abs": "fabs", "floor": "floor", "ceil": "ceil", "trunc": "trunc", "round": "roundeven", "sqrt": "sqrt",
    "copysign": "copysign",
    **{name: name for name in ("sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "exp", "exp2", "log",
                               "log2", "log10", "pow", "atan2")},
}
LIBRARY = ("expm1", "log1p", "erf", "erfc", "hypot")  # of the C library, without an intrinsic of LLVM


def memory(dtype: torch.dtype) -> str:
    """The LLVM type of an element in memory: a bool is a byte."""
    return "i8" if dtype == torch.bool else SCALARS[dtype]


def scalar_suffix(scalar: str) -> str:
    return {"float": "f32", "double": "f64"}.get(scalar, scalar)


def alignment(dtype: torch.dtype) -> int:
    return 1 if dtype == torch.bool else dtype.itemsize


def literal(number: bool | int | float, dtype: torch.dtype) -> str:
    """A constant in LLVM IR: floats by the bits of the equal double."""
    if dtype == torch.bool:
        return "true" if number else "false"
    if dtype in INTEGERS:
        return str(int(number))
    return f"0x{struct.unpack('<Q', struct.pack('<d', number))[0]:016X}"
