"""Infers dtype and shape of torch's operations on lanes, where the rule is simple.

torch can tell for every operation, on tensors without contents. But most of those rules it has in Python: an operation takes
a tenth of a millisecond, and the first imports torch's own compiler, which takes a second.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

Outcome = tuple[torch.dtype, torch.Size]

INFERRED: dict[str, Callable[..., Outcome | None]] = {}  # None: torch is to tell, or to refuse


def _rule_for(*names: str):
    """Decorator: a rule for these operations of `torch.ops.aten`."""

    def add(rule):
        INFERRED.update(dict.fromkeys(names, rule))
        return rule

    return add


def largest(*arguments) -> torch.Size:
    """The shape to which tensors of shapes () and (N,) are broadcast."""
    return max((argument.shape for argument in arguments if isinstance(argument, Tensor)), key=len)


@_rule_for("add", "mul")
def promoted(a, b=None, *more, **options) -> Outcome:
    return a.dtype if b is None else torch.result_type(a, b), largest(a, b)


@_rule_for("rsub", "sub", "remainder", "fmod", "maximum", "minimum", "clamp_min", "clamp_max", "neg", "abs", "floor", "ceil",
           "trunc", "round", "pow", "hypot")
def of_numbers(a, b=None, *more, **options) -> Outcome | None:
    dtype, shape = promoted(a, b)
    return None if dtype == torch.bool else (dtype, shape)


@_rule_for("div", "sqrt", "copysign", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "exp", "exp2",
           "expm1", "log", "log2", "log10", "log1p", "erf", "erfc", "atan2", "reciprocal", "rsqrt")
def floating(a, b=None, *, rounding_mode: str | None = None) -> Outcome | None:
    if rounding_mode is not None:
        return of_numbers(a, b)
    dtype, shape = promoted(a, b)
    return dtype if dtype.is_floating_point else torch.get_default_dtype(), shape


@_rule_for("bitwise_and", "__and__", "bitwise_or", "__or__", "bitwise_xor", "__xor__", "bitwise_not", "bitwise_left_shift",
           "__lshift__", "bitwise_right_shift", "__rshift__")
def of_bits(a, b=None) -> Outcome | None:
    dtype, shape = promoted(a, b)
    return None if dtype.is_floating_point else (dtype, shape)


@_rule_for("eq", "ne", "lt", "le", "gt", "ge", "logical_and", "logical_or", "logical_xor", "logical_not")
def decided(a, b=None) -> Outcome:
    return torch.bool, largest(a, b)


@_rule_for("where")
def chosen_value(condition, a, b) -> Outcome | None:
    return (torch.result_type(a, b), largest(condition, a, b)) if condition.dtype == torch.bool else None


@_rule_for("clone", "_to_copy", "zeros_like", "ones_like", "full_like")
def like(x: Tensor, *arguments, dtype: torch.dtype | None = None, **options) -> Outcome:
    return dtype or x.dtype, x.shape


@_rule_for("_efficientzerotensor")
def zero_tensor(shape, *arguments, dtype: torch.dtype, **options) -> Outcome | None:
    """Makes an ordinary tensor instead of one that torch knows to be zero, since operations on such are hidden."""
    return (dtype, torch.Size(shape)) if len(shape) else None


@_rule_for("index_select")
def read_entry(table: Tensor, dimension: int, index: Tensor) -> Outcome | None:
    return (table.dtype, index.shape) if index.dim() == 1 and index.dtype in (torch.int32, torch.int64) else None
