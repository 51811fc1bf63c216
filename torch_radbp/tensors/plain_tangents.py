"""Forward mode in plain torch, in the time of its operations.

Where one operand of a product, a sum, a quotient or a greater one of two is a dual tensor and the other has no tangent,
torch takes zeros of a special kind for its tangent, and asks functions in Python for the shape of what these come to. This
takes fifty times as long as the operation itself on some hundred lanes. In `PlainTangents` tangents of these operations are
computed without that; all values, and tangents where they are finite, are those of torch.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor
from torch.autograd import forward_ad
from torch.overrides import TorchFunctionMode

from torch_radbp.tensors.differentiated import linear, primal, tangent_of


def product(function: Callable, one: Tensor | float, other: Tensor | float) -> Tensor:
    """One operand moves, whichever."""
    return linear(function, one, other) if _moves(one) else linear(function, other, one)


def quotient(function: Callable, one: Tensor | float, other: Tensor | float) -> Tensor:
    """One operand moves."""
    return linear(function, one, other) if _moves(one) else with_zeros(function, one, other)


def quotient_of_number(function: Callable, below: Tensor, number: float) -> Tensor:
    """`number / below`, of which `below` moves."""
    return linear(Tensor.mul, below.reciprocal(), number)


def total(function: Callable, one: Tensor, other: Tensor | float) -> Tensor:
    """A sum or difference with a number, or of two tensors of which one moves."""
    if isinstance(other, Tensor):
        return with_zeros(function, one, other)
    return forward_ad.make_dual(function(primal(one), other), tangent_of(one).clone())


def with_zeros(function: Callable, *operands: Tensor) -> Tensor:
    """A function of tensors of which those without a tangent are given one, zero."""
    return function(*[part if _moves(part) or not part.is_floating_point()
                      else forward_ad.make_dual(part, torch.zeros_like(part)) for part in operands])


RULES: dict[Callable, Callable] = {
    Tensor.mul: product, torch.mul: product,
    Tensor.div: quotient, torch.div: quotient, Tensor.__rtruediv__: quotient_of_number,
    Tensor.add: total, torch.add: total, Tensor.sub: total, torch.sub: total,
    **dict.fromkeys((torch.maximum, torch.minimum, torch.atan2, torch.hypot), with_zeros),
}


class PlainTangents(TorchFunctionMode):
    """A context in which torch computes tangents without functions in Python; for forward mode alone, where no graph is
    recorded."""

    def __torch_function__(self, function, types, arguments=(), keywords=None):
        rule = RULES.get(function)
        if rule is None or keywords or len(arguments) != 2 or _moves(arguments[0]) == _moves(arguments[1]):
            return function(*arguments, **(keywords or {}))
        return rule(function, *arguments)


def _moves(part: Tensor | float) -> bool:
    return isinstance(part, Tensor) and tangent_of(part) is not None
