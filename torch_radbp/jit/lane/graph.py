"""Programs: functions of lanes as values in the order in which they are computed.

A value is of the *lanes* (one number a lane), a *number* (one for all lanes) or a *table* (read at indices only). There are
some forty operations; whatever torch has beyond them is written in terms of these while a function is traced.
"""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from typing import Any, NamedTuple

import torch

LANES, NUMBER, TABLE = "lanes", "number", "table"

# Operation: number of values that it takes. All take values of one dtype but for `gather`, `select` and the casts.
OPERATIONS = {
    "input": 0, "constant": 0,
    "cast": 1, "bitcast": 1,
    "neg": 1, "abs": 1, "not": 1, "floor": 1, "ceil": 1, "trunc": 1, "round": 1, "sqrt": 1,
    "add": 2, "sub": 2, "mul": 2, "div": 2, "rem": 2, "copysign": 2,  # `div` truncates integers; `rem` has the first's sign
    "and": 2, "or": 2, "xor": 2, "shl": 2, "ashr": 2,
    "eq": 2, "ne": 2, "lt": 2, "le": 2, "gt": 2, "ge": 2,
    "select": 3,  # condition, value where it holds, value elsewhere
    "gather": 2,  # table, index
    "search": 2,  # sorted table, number: how many entries are at most the number, int64
    # Of float64 only, and of vectors lane by lane: functions of the C library.
    "sin": 1, "cos": 1, "tan": 1, "asin": 1, "acos": 1, "atan": 1, "sinh": 1, "cosh": 1, "tanh": 1, "exp": 1, "exp2": 1,
    "expm1": 1, "log": 1, "log2": 1, "log10": 1, "log1p": 1, "erf": 1, "erfc": 1, "pow": 2, "atan2": 2, "hypot": 2,
}


class Value:
    """One value of a program, as a node of its graph; compared by identity."""

    __slots__ = ("operation", "arguments", "dtype", "kind", "static", "order")

    def __init__(self, operation: str, arguments: tuple[Value, ...], dtype: torch.dtype, kind: str, static: Any, order: int):
        self.operation = operation
        self.arguments = arguments
        self.dtype = dtype
        self.kind = kind  # LANES, NUMBER or TABLE
        self.static = static  # of an input its place among the arguments, of a constant its number
        self.order = order  # in which values were made

    def __repr__(self) -> str:
        arguments = ", ".join(f"v{argument.order}" for argument in self.arguments)
        static = "" if self.static is None else f" {self.static}"
        return f"v{self.order} = {self.operation}{static}({arguments}): {self.kind} {str(self.dtype).removeprefix('torch.')}"


class Repetition(NamedTuple):
    """How a program is repeated for a lane: what it reads of some tables is, from the second time on, its last output."""

    running: int  # the output that tells whether the lane goes on
    state: tuple[tuple[int, int], ...]  # of each of these tables its place among the arguments, and the output


class Program(NamedTuple):
    """A function of lanes as a sequence of values, without those that no output needs."""

    inputs: tuple[Value, ...]  # that are used
    values: tuple[Value, ...]  # inputs included
    outputs: tuple[Value | None, ...]  # in the order of the function's results; None where it returns None
    columns: Mapping[int, Any] = {}  # column layouts of tables by index of the argument; see `jit/arguments.py`
    repetition: Repetition | None = None  # None: it is computed once

    def column(self, table: Value) -> Any:
        """The column layout of a table; None if it is contiguous."""
        return self.columns.get(table.static) if table.operation == "input" else None

    @property
    def searched(self) -> tuple[int, ...]:
        """The indices of inputs whose lengths are needed, for bisection."""
        tables = {value.arguments[0] for value in self.values if value.operation == "search"}
        return tuple(number for number, value in enumerate(self.inputs) if value in tables)

    def __str__(self) -> str:
        results = ", ".join("none" if value is None else f"v{value.order}" for value in self.outputs)
        return "\n".join([*map(repr, self.values), f"return {results}"])


class Builder:
    """Makes the values of a program; the same operation on the same values gives the same value."""

    def __init__(self) -> None:
        self.values: dict[tuple, Value] = {}

    def value(self, operation: str, arguments: tuple[Value, ...], dtype: torch.dtype, kind: str | None = None,
              static: Any = None) -> Value:
        """Makes a value, with a number for each lane unless all arguments are numbers or `kind` says otherwise."""
        if kind is None:
            kind = NUMBER
            for argument in arguments:
                if argument.kind != NUMBER:
                    kind = LANES
                    break
        assert len(arguments) == OPERATIONS[operation], (operation, arguments)
        key = (operation, arguments, dtype, kind, static if not isinstance(static, float) else (static.hex(), "float"))
        value = self.values.get(key)
        if value is None:
            value = self.values[key] = Value(operation, arguments, dtype, kind, static, len(self.values))
        return value

    def constant(self, number: bool | int | float, dtype: torch.dtype) -> Value:
        """Makes a constant, rounded to `dtype`."""
        return self.value("constant", (), dtype, NUMBER, _rounded(number, dtype))

    def cast(self, value: Value, dtype: torch.dtype) -> Value:
        """Converts a value to another dtype, as `Tensor.to` does."""
        if value.dtype == dtype:
            return value
        if value.operation == "constant":
            return self.constant(value.static, dtype)
        return self.value("cast", (value,), dtype)


def _rounded(number: bool | int | float, dtype: torch.dtype) -> bool | int | float:
    """Rounds a number to a dtype."""
    if type(number) is float and dtype == torch.float32:
        return ctypes.c_float(number).value
    if type(number) is float and dtype == torch.float64:
        return number
    return torch.tensor(number, dtype=dtype, device="cpu").item()


def program(outputs: tuple[Value | None, ...]) -> Program:
    """The program of all values on which `outputs` depend, in order."""
    needed: set[Value] = set()
    waiting = [value for value in outputs if value is not None]
    while waiting:
        value = waiting.pop()
        if value not in needed:
            needed.add(value)
            waiting.extend(value.arguments)
    values = tuple(sorted(needed, key=lambda value: value.order))
    return Program(tuple(value for value in values if value.operation == "input"), values, outputs)
