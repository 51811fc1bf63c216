"""Fused loops over lanes that carry tangents: forward mode inside of the loop.

torch's forward mode acts above the operations that a function comes down to. So a function of dual tensors is traced like
any other, as a function of values and tangents, and both are computed in one loop.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from contextlib import nullcontext
from typing import Any

from torch import Tensor
from torch.autograd import forward_ad

from torch_radbp.jit.run import LaneFunction
from torch_radbp.jit.target import Target
from torch_radbp.tensors.differentiated import primal, tangent_of
from torch_radbp.tensors.record import leaves_of, with_leaves
from torch_radbp.tensors.torch_internals import inside_dual_level


def parted(record: Any) -> tuple[Any, Any]:
    """The values of a record of dual tensors, and their tangents: None of what has none."""
    leaves = leaves_of(record)
    tangents = [tangent_of(leaf) if isinstance(leaf, Tensor) else None for leaf in leaves]
    values = [primal(leaf) if tangent is not None else leaf for leaf, tangent in zip(leaves, tangents)]
    return with_leaves(record, values), with_leaves(record, tangents)


def joined(values: Any, tangents: Any) -> Any:
    """The record of dual tensors of these parts."""
    return with_leaves(values, [value if tangent is None else forward_ad.make_dual(value, tangent)
                                for value, tangent in zip(leaves_of(values), leaves_of(tangents))])


def with_tangents(function: Callable) -> Callable:
    """A function of values, and then of their tangents; it returns both, too."""
    names = list(inspect.signature(function).parameters)
    kind = inspect.Parameter.POSITIONAL_ONLY

    def of_parts(*parts):
        with nullcontext() if inside_dual_level() else forward_ad.dual_level():
            return parted(function(*map(joined, parts[:len(names)], parts[len(names):])))

    of_parts.__name__ = function.__name__
    of_parts.__signature__ = inspect.Signature([inspect.Parameter(name, kind)
                                                for name in (*names, *map(tangents_of, names))])
    return of_parts


def tangents_of(name: str) -> str:
    """The name of the parameter for the tangents of another."""
    return f"tangents_of_{name}"


class DualFunction:
    """A function of dual tensors of the lanes, run as one fused loop. Arguments, errors: see `LaneFunction`."""

    def __init__(self, function: Callable, tables: tuple[str, ...] = (), target: Target | None = None):
        self.fused = LaneFunction(with_tangents(function), (*tables, *map(tangents_of, tables)), target)

    def __call__(self, *arguments):
        values, tangents = zip(*map(parted, arguments))
        return joined(*self.fused(*values, *tangents))
