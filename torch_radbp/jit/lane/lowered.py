"""Lowers programs for targets without a C library, by formulas for its functions.

A GPU has no functions of float64 such as `exp`. Wherever a program uses one, the formula of `elementary_double.py` takes its
place, traced as any function is; so tracing knows nothing of targets.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence

import torch

from torch_radbp.jit.lane.elementary_double import FORMULAS
from torch_radbp.jit.lane.graph import LANES, Builder, Program, Value, program
from torch_radbp.jit.lane.trace import traced_program


@functools.cache
def _formula(operation: str) -> Program:
    """The program of a C library function in basic operations."""
    arguments = 2 if operation in ("pow", "atan2", "hypot") else 1
    return traced_program(lambda *x: [FORMULAS[operation](*x)], [torch.float64] * arguments, [LANES] * arguments)


def without_library(given: Program) -> Program:
    """The program with C library functions replaced by formulas; inputs come first among its values."""
    if not any([value.operation in FORMULAS for value in given.values]):
        used = {argument for value in given.values for argument in value.arguments}.union(given.outputs)
        return given._replace(values=(*[value for value in given.inputs if value in used],
                                      *[value for value in given.values if value.operation != "input"]))
    builder = Builder()
    made = inlined(builder, given._replace(values=(*given.inputs, *given.values)), {})  # what no value needs among them
    lowered = program(tuple(None if value is None else made[value] for value in given.outputs))
    inputs = tuple(made[value] for value in given.inputs)  # in the same order, all of them
    return lowered._replace(inputs=inputs, columns=given.columns, repetition=given.repetition)


def inlined(builder: Builder, given: Program, made: dict[Value, Value]) -> dict[Value, Value]:
    """Inlines a program into `builder`; `made` maps its values to new ones and is extended."""
    for value in given.values:
        if value in made:
            continue
        arguments = tuple(made[argument] for argument in value.arguments)
        made[value] = _expanded(builder, value.operation, arguments) if value.operation in FORMULAS else builder.value(
            value.operation, arguments, value.dtype, kind_of(value), value.static)
    return made


def _expanded(builder: Builder, operation: str, arguments: Sequence[Value]) -> Value:
    """Expands a C library function by its formula."""
    body = _formula(operation)
    inputs = {value: arguments[value.static] for value in body.inputs}
    return inlined(builder, body, inputs)[body.outputs[0]]


def kind_of(value: Value) -> str | None:
    """The kind (of lanes, number or table) of a value, if its operation does not determine it; else None."""
    return value.kind if value.operation in ("input", "constant", "gather", "search") else None
