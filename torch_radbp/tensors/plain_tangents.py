"""Forward mode in plain torch, in the time of its operations.

Where one operand of a product, a sum, a quotient or a greater one of two is a dual tensor and the other has no tangent,
torch takes zeros of a special kind for its tangent, and asks functions in Python for the shape of what these come to. This
takes fifty times as long as the operation itself on some hundred lanes. In `PlainTangents` tangents of these operations are
computed without that; all values, and tangents where they are finite, are those of torch.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode

from torch_radbp.tensors.torch_internals import dual_of, inside_dual_level, unpacked_dual


class Dual(NamedTuple):
    """A dual tensor taken apart: an operand with a tangent."""

    value: Tensor
    tangent: Tensor

    @staticmethod
    def of(operand: Tensor | float) -> Dual | None:
        """The parts of an operand; None if it has no tangent."""
        if not isinstance(operand, Tensor) or not operand.is_floating_point():
            return None
        value, tangent = unpacked_dual(operand)
        return None if tangent is None else Dual(value, tangent)


def product_of(function: Callable, one: Tensor | Dual, other: Tensor | Dual | float) -> Tensor:
    """The result, a dual tensor, of a function that is linear in the operand with a tangent, and has one such operand."""
    moving, still = (one, other) if isinstance(one, Dual) else (other, one)
    return dual_of(function(moving.value, still), function(moving.tangent, still))


def quotient_of(function: Callable, one: Tensor | Dual, other: Tensor | Dual | float) -> Tensor:
    """The quotient `one / other`, a dual tensor, of which one operand has a tangent."""
    return product_of(function, one, other) if isinstance(one, Dual) else with_zeros(function, one, other)


def quotient_of_number(function: Callable, below: Dual, number: float) -> Tensor:
    """The quotient `number / below`, a dual tensor."""
    inverse = torch.reciprocal(dual_of(*below))
    return inverse if number == 1.0 else product_of(Tensor.mul, Dual(*unpacked_dual(inverse)), number)


def sum_of(function: Callable, one: Tensor | Dual, other: Tensor | Dual | float) -> Tensor:
    """A sum or a difference, a dual tensor, of which one operand has a tangent."""
    if isinstance(one, Tensor) or isinstance(other, Tensor):
        return with_zeros(function, one, other)
    return dual_of(function(one.value, other), one.tangent.clone())


def with_zeros(function: Callable, *operands: Tensor | Dual | float) -> Tensor:
    """The result of a function of operands of which one has a tangent; a tensor without one is given the tangent zero."""
    return function(*[dual_of(*part) if isinstance(part, Dual)
                      else dual_of(part, torch.zeros_like(part)) if isinstance(part, Tensor) and part.is_floating_point()
                      else part for part in operands])


RULES: dict[Callable, Callable] = {
    Tensor.mul: product_of, torch.mul: product_of,
    Tensor.div: quotient_of, torch.div: quotient_of, Tensor.__rtruediv__: quotient_of_number,
    Tensor.add: sum_of, torch.add: sum_of, Tensor.sub: sum_of, torch.sub: sum_of,
    **dict.fromkeys((torch.maximum, torch.minimum, torch.atan2, torch.hypot), with_zeros),
}


class PlainTangents(TorchFunctionMode):
    """A context in which torch computes tangents without functions in Python; for forward mode alone, where no graph is
    recorded."""

    def __torch_function__(self, function, types, arguments=(), keywords=None):
        rule = RULES.get(function)
        if rule is None or keywords or len(arguments) != 2 or not inside_dual_level():
            return function(*arguments, **(keywords or {}))
        one, other = arguments
        moving = Dual.of(one), Dual.of(other)
        if (moving[0] is None) == (moving[1] is None):
            return function(one, other)
        return rule(function, one if moving[0] is None else moving[0], other if moving[1] is None else moving[1])
