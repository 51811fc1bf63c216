"""Compiled loops that carry tangents: forward mode inside of the loop.

torch's forward mode acts above the operations that a function comes down to. So a function of dual tensors is traced like
any other, as a function of values and tangents, and both are computed in one loop.
"""

from __future__ import annotations

import inspect
import operator
from collections.abc import Callable
from contextlib import nullcontext
from copy import copy
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.autograd import forward_ad

from torch_radbp.jit.run import LaneFunction
from torch_radbp.jit.target import Target
from torch_radbp.tensors.differentiated import primal, tangent_of
from torch_radbp.tensors.record import leaves_of, tensors_in, with_leaves
from torch_radbp.tensors.torch_internals import inside_dual_level


def values_and_tangents(record: Any) -> tuple[Any, Any]:
    """Splits a record of dual tensors into values and tangents; None where there is no tangent."""
    leaves = leaves_of(record)
    tangents = [tangent_of(leaf) if isinstance(leaf, Tensor) else None for leaf in leaves]
    values = [primal(leaf) if tangent is not None else leaf for leaf, tangent in zip(leaves, tangents)]
    return with_leaves(record, values), with_leaves(record, tangents)


def tangents_and_tensors(record: Any) -> list[Tensor]:
    """The tangents of a record, in order, and then its tensors."""
    if not inside_dual_level():
        return tensors_in(record)
    values, tangents = values_and_tangents(record)
    return [*tensors_in(tangents), *tensors_in(values)]


def dual(values: Any, tangents: Any) -> Any:
    """Joins values and tangents to a record of dual tensors."""
    return with_leaves(values, [value if tangent is None else forward_ad.make_dual(value, tangent)
                                for value, tangent in zip(leaves_of(values), leaves_of(tangents))])


def with_tangents(function: Callable) -> Callable:
    """A function whose parameters are those of the given one, each followed by its tangents; it returns the given function's
    values and tangents."""
    names = list(inspect.signature(function).parameters)
    kind = inspect.Parameter.POSITIONAL_ONLY

    def of_parts(*parts):
        *pairs, asked = parts
        with nullcontext() if inside_dual_level() else forward_ad.dual_level():
            return completed(*values_and_tangents(function(*map(dual, pairs[::2], pairs[1::2]))), asked)

    of_parts.__name__ = function.__name__
    of_parts.__module__ = function.__module__  # its meaning is that function's, see `fingerprint`
    of_parts.__signature__ = inspect.Signature([inspect.Parameter(part, kind) for name in names
                                                for part in (name, tangents_of(name))]
                                               + [inspect.Parameter("asked", kind)])
    return of_parts


def completed(values: Any, tangents: Any, asked: tuple[bool, ...] | None) -> tuple[Any, Any]:
    """Values and tangents, with zeros for missing tangents that `asked` wants.

    Args:
        values, tangents: as of `values_and_tangents`.
        asked: whether each leaf shall have a tangent; None: those that have one.

    Raises:
        ValueError: if there are tangents that are not asked for.
    """
    if asked is None:
        return values, tangents
    found = leaves_of(tangents)
    if any(tangent is not None and not own for tangent, own in zip(found, asked, strict=True)):
        raise ValueError(f"results have tangents where there is no room for them: {asked} are asked for")
    return values, with_leaves(tangents, [torch.zeros_like(value) if own and tangent is None else tangent
                                          for value, tangent, own in zip(leaves_of(values), found, asked)])


def tangents_of(name: str) -> str:
    """The name of the parameter for another parameter's tangents."""
    return f"tangents_of_{name}"


class DualParts(NamedTuple):
    """Arguments of a dual function, split into values and tangents."""

    arguments: tuple[Any, ...]  # values and tangents of each
    moving: bool  # True if there is any tangent

    @staticmethod
    def of(arguments: tuple) -> DualParts:
        """Splits arguments into values and tangents."""
        pairs = [values_and_tangents(argument) for argument in arguments]
        moving = any([leaf is not None for _, tangents in pairs for leaf in leaves_of(tangents)])
        return DualParts(tuple([part for pair in pairs for part in pair]), moving)


class DualFunction:
    """A function of dual tensors, run as one compiled loop. Arguments, errors: see `LaneFunction`."""

    def __init__(self, function: Callable, tables: tuple[str, ...] = (), target: Target | None = None):
        self.fused = LaneFunction(with_tangents(function), (*tables, *map(tangents_of, tables)), target)
        self.known: tuple = ()  # the first arguments of all calls that are to be quick
        self.known_parts: DualParts | None = None

    def knowing(self, *arguments) -> DualFunction:
        """A copy of this function that prepares its first arguments once for several calls within one dual level."""
        other = copy(self)
        other.known, other.known_parts = arguments, None
        return other

    def parts(self, arguments: tuple) -> DualParts:
        """Splits arguments into values and tangents; those prepared by `knowing` are split once for all calls."""
        if not self.known or not all(map(operator.is_, self.known, arguments)):
            return DualParts.of(arguments)
        if self.known_parts is None:
            self.known_parts = DualParts.of(self.known)
            self.fused = self.fused.knowing(*self.known_parts.arguments)
        rest = DualParts.of(arguments[len(self.known):])
        return DualParts((*self.known_parts.arguments, *rest.arguments), self.known_parts.moving or rest.moving)

    def of_parts(self, parts: DualParts):
        """Calls the function with split arguments."""
        return dual(*self.fused(*parts.arguments, None))

    def into(self, results, first: int, parts: DualParts) -> None:
        """Calls the function with split arguments, and writes into dual tensors from the entry `first` on."""
        values, tangents = values_and_tangents(results)
        asked = tuple([tangent is not None for tangent in leaves_of(tangents)])
        self.fused.into((values, tangents), first, *parts.arguments, asked)

    def __call__(self, *arguments):
        return self.of_parts(self.parts(arguments))
