"""Torch's operations in terms of those of `graph`: one short handler for each family.

A handler gets the tracer, the result as torch infers it (for its dtype) and the operation's arguments, and returns a value.
What is a formula of other operations is written in torch (`DECOMPOSED`) and traced in turn.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
from torch import Tensor

from torch_radbp.jit.lane import elementary
from torch_radbp.jit.lane.graph import TABLE, Value
from torch_radbp.jit.lane.refusal import refusal

HANDLERS: dict[str, Callable[..., Value]] = {}
DECOMPOSED: dict[str, Callable[..., Tensor]] = {}


def handles(*names: str):
    """Decorator: registers the handler of these operations of `torch.ops.aten`."""

    def add(function):
        HANDLERS.update(dict.fromkeys(names, function))
        return function

    return add


def decomposes(*names: str):
    """Decorator: registers a formula in torch for these operations of `torch.ops.aten`."""

    def add(function):
        DECOMPOSED.update(dict.fromkeys(names, function))
        return function

    return add


# -- Arithmetic ------------------------------------------------------------------------------------------------------------


@handles("neg", "abs", "floor", "ceil", "trunc", "round", "sqrt", "mul", "copysign", "bitwise_and", "__and__",
         "bitwise_or", "__or__", "bitwise_xor", "__xor__", "bitwise_left_shift", "__lshift__", "bitwise_right_shift",
         "__rshift__", "bitwise_not")
def elementwise(tracer, result: Tensor, *arguments, name: str) -> Value:
    operation = {"bitwise_left_shift": "shl", "__lshift__": "shl", "bitwise_right_shift": "ashr",
                 "__rshift__": "ashr"}.get(name, name.removeprefix("bitwise_").strip("_"))
    if operation in ("floor", "ceil", "trunc", "round") and not result.dtype.is_floating_point:
        return tracer.operand(arguments[0], result.dtype)
    if operation == "mul" and result.dtype == torch.bool:
        operation = "and"
    return tracer.apply(operation, result.dtype, *arguments)


@handles("add", "sub")
def sum_or_difference(tracer, result: Tensor, a, b, alpha=1, *, name: str) -> Value:
    b = tracer.operand(b, result.dtype)
    if alpha != 1:
        b = tracer.apply("mul", result.dtype, b, alpha)
    return tracer.apply("or" if result.dtype == torch.bool else name, result.dtype, a, b)


@handles("rsub")
def reversed_difference(tracer, result: Tensor, a, b, alpha=1, *, name: str) -> Value:
    return sum_or_difference(tracer, result, b, a, alpha, name="sub")


@handles("div")
def quotient(tracer, result: Tensor, a, b, *, rounding_mode: str | None = None, name: str) -> Value:
    dtype = result.dtype
    if rounding_mode is None:
        return tracer.apply("div", dtype, a, b)
    whole = tracer.apply("div", dtype, a, b)  # of integers it is truncated
    if dtype.is_floating_point:
        return tracer.apply("floor" if rounding_mode == "floor" else "trunc", dtype, whole)
    if rounding_mode == "trunc":
        return whole
    rest = tracer.apply("rem", dtype, a, b)
    return tracer.select(differs_in_sign(tracer, rest, b, dtype), tracer.apply("sub", dtype, whole, 1), whole)


@handles("reciprocal", "rsqrt")
def inverse(tracer, result: Tensor, x, *, name: str) -> Value:
    return tracer.apply("div", result.dtype, 1, tracer.apply("sqrt", result.dtype, x) if name == "rsqrt" else x)


@handles("remainder", "fmod")
def remainder(tracer, result: Tensor, a, b, *, name: str) -> Value:
    rest = tracer.apply("rem", result.dtype, a, b)  # has the sign of `a`
    if name == "fmod":
        return rest
    return tracer.select(differs_in_sign(tracer, rest, b, result.dtype), tracer.apply("add", result.dtype, rest, b), rest)


def differs_in_sign(tracer, rest: Value, divisor, dtype: torch.dtype) -> Value:
    """A flag: the remainder of a truncated division is nonzero and has another sign than the divisor."""
    below = tracer.compare("lt", dtype, rest, 0)
    other = tracer.builder.value("xor", (below, tracer.compare("lt", dtype, divisor, 0)), torch.bool)
    return tracer.builder.value("and", (other, tracer.compare("ne", dtype, rest, 0)), torch.bool)


@handles("eq", "ne", "lt", "le", "gt", "ge")
def comparison(tracer, result: Tensor, a, b, *, name: str) -> Value:
    return tracer.compare(name, torch.result_type(a, b), a, b)


@handles("logical_and", "logical_or", "logical_xor", "logical_not")
def logic(tracer, result: Tensor, *arguments, name: str) -> Value:
    return tracer.apply(name.removeprefix("logical_"), torch.bool, *arguments)


@handles("where")
def choice(tracer, result: Tensor, condition, a, b, *, name: str) -> Value:
    return tracer.select(tracer.operand(condition, torch.bool), tracer.operand(a, result.dtype),
                         tracer.operand(b, result.dtype))


@handles("maximum", "minimum", "clamp_min", "clamp_max")
def bound(tracer, result: Tensor, a, b, *, name: str) -> Value:
    """Maximum or minimum; NaN if either argument is."""
    dtype = result.dtype
    x, y = tracer.operand(a, dtype), tracer.operand(b, dtype)
    kept = tracer.select(tracer.compare("lt" if name in ("maximum", "clamp_min") else "gt", dtype, x, y), y, x)
    if dtype.is_floating_point and y.operation != "constant":
        kept = tracer.select(tracer.compare("ne", dtype, y, y), y, kept)
    return kept


@decomposes("clamp")
def _clamp(x: Tensor, min=None, max=None) -> Tensor:
    x = x if min is None else x.clamp_min(min)
    return x if max is None else x.clamp_max(max)


# -- What is not computed --------------------------------------------------------------------------------------------------


@handles("zeros", "ones", "_efficientzerotensor", "zeros_like", "ones_like", "new_zeros", "new_ones", "zero")
def zero_or_one(tracer, result: Tensor, *arguments, name: str, **options) -> Value:
    return tracer.builder.constant(int("one" in name), result.dtype)


@handles("full", "full_like", "new_full", "fill", "scalar_tensor")
def filled(tracer, result: Tensor, *arguments, name: str, fill_value=None, **options) -> Value:
    return tracer.operand(arguments[-1] if fill_value is None else fill_value, result.dtype)


@handles("clone", "detach", "alias", "lift_fresh", "lift_fresh_copy", "_to_copy", "expand", "view",
         "_unsafe_view", "squeeze", "unsqueeze", "contiguous")
def same(tracer, result: Tensor, x: Tensor, *arguments, name: str, **options) -> Value:
    if name == "view" and arguments and isinstance(arguments[0], torch.dtype):
        return tracer.builder.value("bitcast", (tracer.lanes_or_number(x, "an operand"),), result.dtype)
    value = tracer.value_of(x, "an operand")
    return value if value.kind == TABLE and result.dtype == x.dtype else tracer.operand(x, result.dtype)


@handles("copy")
def copied(tracer, result: Tensor, target: Tensor, source: Tensor, *arguments, name: str) -> Value:
    return tracer.operand(source, result.dtype)


@handles("index_select", "index", "gather")
def entries(tracer, result: Tensor, table: Tensor, *arguments, name: str, **options) -> Value:
    index = arguments[0][0] if name == "index" else arguments[1]
    entries = tracer.value_of(table, "a table")
    if entries.kind != TABLE:
        raise refusal(f"torch.{name} of what is not declared a table")
    place = tracer.lanes_or_number(index, "an index")
    return tracer.builder.value("gather", (entries, place), result.dtype, place.kind)


@handles("searchsorted")
def search(tracer, result: Tensor, table: Tensor, x: Tensor, *, right: bool = False, name: str, **options) -> Value:
    entries = tracer.value_of(table, "a table")
    if entries.kind != TABLE or not right or result.dtype != torch.int64:
        raise refusal("torch.searchsorted but with right=True, in a table, to int64,")
    return tracer.builder.value("search", (entries, tracer.operand(x, entries.dtype)), torch.int64)


# -- Formulas of other operations ------------------------------------------------------------------------------------------

DECOMPOSED |= {
    "square": lambda x: x * x,
    "isnan": lambda x: x != x,
    "isinf": lambda x: x.abs() == math.inf,
    "isfinite": lambda x: x.abs() < math.inf,
    "sigmoid": lambda x: 1.0 / (1.0 + torch.exp(-x)),
    "masked_fill": lambda x, mask, value: torch.where(mask, value, x),
    "addcmul": lambda x, a, b, value=1: x + value * a * b,
    "addcdiv": lambda x, a, b, value=1: x + value * a / b,
    "lerp": lambda a, b, weight: a + weight * (b - a),
    "deg2rad": lambda x: x * (math.pi / 180),
    "rad2deg": lambda x: x * (180 / math.pi),
    "frac": lambda x: x - torch.trunc(x),
    "tanh_backward": lambda grad, y: grad * (1 - y * y),
    "sigmoid_backward": lambda grad, y: grad * (y * (1 - y)),
    "threshold_backward": lambda grad, x, threshold: torch.where(x <= threshold, 0.0, grad),
}


@decomposes("sign", "sgn")
def sign(x: Tensor) -> Tensor:
    return (x > 0).to(x.dtype) - (x < 0).to(x.dtype)


@handles("pow")
def power(tracer, result: Tensor, x: Tensor | float, exponent: Tensor | float, *, name: str) -> Value:
    """Powers: by multiplication for small integer exponents, else by the C library in float64."""
    if isinstance(exponent, Tensor) or exponent not in (-2, -1, 0.5, *range(9)):
        return elementary_function(tracer, result, x, exponent, name=name)
    if exponent == 0.5:
        return tracer.apply("sqrt", result.dtype, x)
    product, factor, left = tracer.operand(1, result.dtype), tracer.operand(x, result.dtype), abs(int(exponent))
    while left:
        if left % 2:
            product = tracer.apply("mul", result.dtype, product, factor)
        left, factor = left // 2, tracer.apply("mul", result.dtype, factor, factor)
    return product if exponent >= 0 else tracer.apply("div", result.dtype, 1, product)


@handles(*(name for name in elementary.IN_LIBRARY if name != "pow"))
def elementary_function(tracer, result: Tensor, *arguments, name: str) -> Value:
    """Elementary functions: float64 by the C library; float32 by a formula or by float64."""
    dtype = result.dtype
    if dtype == torch.float64:
        return tracer.apply(name, dtype, *arguments)
    formula = elementary.FORMULAS.get(name)
    with tracer:
        tensors = [argument.to(dtype) if isinstance(argument, Tensor) else argument for argument in arguments]
        answer = formula(*tensors) if formula else elementary.in_double(getattr(torch, name), *tensors)
    return tracer.value_of(answer, f"torch.{name}")
