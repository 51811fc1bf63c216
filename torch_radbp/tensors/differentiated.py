"""Whether tensors are differentiated, backward (`requires_grad`) or forward (`forward_ad`), and how to detach records."""

from __future__ import annotations

import operator
from collections.abc import Callable

import torch
from torch import Tensor
from torch.autograd import forward_ad

from torch_radbp.tensors.record import NESTED, mapped, tensors_in, with_parts
from torch_radbp.tensors.torch_internals import inside_dual_level, unpacked_dual


def tangent_of(tensor: Tensor) -> Tensor | None:
    """The tangent of a dual tensor, None if it has none."""
    if not inside_dual_level():
        return None
    return unpacked_dual(tensor)[1] if tensor.is_floating_point() else None


def primal(tensor: Tensor) -> Tensor:
    """A tensor without its gradient and its forward-mode tangent."""
    if not tensor.is_floating_point():
        return tensor
    return unpacked_dual(tensor)[0].detach() if inside_dual_level() else tensor.detach()


def differentiated(tensor: Tensor) -> bool:
    """True if `tensor` requires a gradient or has a tangent."""
    return tensor.requires_grad or tangent_of(tensor) is not None


def asks_for_derivatives(value) -> bool:
    """True if an attribute is a tensor that is differentiated, backward (if autograd records) or forward."""
    if not isinstance(value, Tensor):
        return False
    return (value.requires_grad and torch.is_grad_enabled()) or tangent_of(value) is not None


def any_differentiated(record) -> bool:
    """True if any tensor of a record requires a gradient or has a tangent."""
    return any(map(differentiated, tensors_in(record)))


def detached(tensors):
    """A detached record of tensors; whatever carries no derivative stays the same object."""
    return without_derivatives(tensors, inside_dual_level())


def without_derivatives(record, forward: bool):
    """A detached record; `forward`: its tensors may be dual tensors."""
    if isinstance(record, Tensor):
        return record.detach() if record.requires_grad or forward and tangent_of(record) is not None else record
    if not isinstance(record, NESTED):
        return record
    parts = list(record.values()) if isinstance(record, dict) else record
    detached_parts = [part if part is None or type(part) is Tensor and not forward and not part.requires_grad
                      else without_derivatives(part, forward) for part in parts]
    return record if all(map(operator.is_, detached_parts, parts)) else with_parts(record, detached_parts)


def moving_with(others, record):
    """A record whose floating-point tensors all have tangents, zeros where there were none, if any tensor of `others` has.

    For what plain torch computes of few numbers. It is much slower with products and sums of a dual tensor and one without
    tangents: in the place of these it puts zeros of a special kind, for whose shape it asks functions in Python.
    """
    if not inside_dual_level() or all(tangent_of(tensor) is None for tensor in tensors_in(others)):
        return record

    def moving(leaf):
        if not isinstance(leaf, Tensor) or not leaf.is_floating_point() or tangent_of(leaf) is not None:
            return leaf
        return forward_ad.make_dual(leaf, torch.zeros_like(leaf))

    return mapped(record, moving)


def linear(operation: Callable[[Tensor, Tensor | float], Tensor], moving: Tensor, still: Tensor | float) -> Tensor:
    """`operation(moving, still)`, a product or a quotient, which is linear in the first operand.

    In forward mode with a second operand that is a number or has no tangent, it is twenty times as fast as torch, which
    computes the tangent by functions in Python.
    """
    tangent = None if torch.is_grad_enabled() else tangent_of(moving)
    if tangent is None or isinstance(still, Tensor) and tangent_of(still) is not None:
        return operation(moving, still)
    return forward_ad.make_dual(operation(primal(moving), still), operation(tangent, still))


def with_derivative_of(value: Tensor, attached: Tensor) -> Tensor:
    """A detached value with the derivative, backward and forward, of another estimate of the same quantity."""
    tangent = None if torch.is_grad_enabled() else tangent_of(attached)
    return value + (attached - primal(attached)) if tangent is None else forward_ad.make_dual(value, tangent)


def settled(value: Tensor) -> Tensor:
    """Detaches the probabilities of a discrete choice (of a lobe, of a light), in all modes of sampling.

    All choices go through here, so that tests can hold them while parameters move.
    """
    return value.detach()


def differentiable(tensors) -> list[Tensor]:
    """The leaves of a record that are differentiated, in order."""
    return [tensor for tensor in tensors_in(tensors) if tensor.requires_grad]
