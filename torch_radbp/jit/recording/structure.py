"""Nested tuples and lists of tensors: flattened and rebuilt; all else belongs to the structure."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor


def flatten(part: Any, leaves: list[Tensor], key: list) -> None:
    """Collects the tensors of nested tuples and lists, and a key of their structure.

    Args:
        part: tensors and anything hashable in nested tuples, named or not, and lists.
        leaves: the tensors are added, in order.
        key: hashable values are added; equal keys have equal structure, dtypes and constants.
    """
    kind = type(part)
    if kind is Tensor or isinstance(part, Tensor):  # the first is quick
        key.append((part.dtype, part.dim()))
        leaves.append(part)
    elif issubclass(kind, (tuple, list)):
        key.append((kind, len(part)))
        for item in part:
            flatten(item, leaves, key)
    else:
        key.append((kind, part))


def of_lanes(key: Sequence) -> tuple:
    """A structure's key, changed to that of the same structure with tensors that all have an entry per lane."""
    return tuple((item[0], 1) if isinstance(item[0], torch.dtype) else item for item in key)


def structure_difference(key: Sequence, other: Sequence) -> tuple[str, str]:
    """The first difference between two structures, in words for a message."""
    return next((_described(a), _described(b)) for a, b in itertools.zip_longest(key, other) if a != b)


def _described(item: tuple | None) -> str:
    """One item of a structure's key, in words."""
    if item is None:
        return "nothing"
    kind, value = item
    if isinstance(kind, torch.dtype):
        return f"{str(kind).removeprefix('torch.')} of {value} dimensions"
    return f"{kind.__name__} of {value}" if issubclass(kind, (tuple, list)) else repr(value)


class Leaf:
    """Placeholder for a tensor in a structure of nested tuples."""


def with_other_leaves(part: Any, next_leaf: Callable[[], Any]) -> Any:
    """Nested tuples with tensors replaced, in order, by results of `next_leaf`."""
    if isinstance(part, Tensor):
        return next_leaf()
    if isinstance(part, (tuple, list)):
        items = [with_other_leaves(item, next_leaf) for item in part]
        return type(part)(*items) if hasattr(part, "_fields") else type(part)(items)
    return part


class Source:
    """Generates the source of a specialised function, and holds the objects that it refers to."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.names: dict[str, Any] = {"new": tuple.__new__}

    def name(self, thing: Any) -> str:
        """A name for an object in the generated source."""
        name = f"c{len(self.names)}"
        self.names[name] = thing
        return name

    def function(self, argument: str, result: str) -> Callable:
        """Compiles the generated lines to a function that returns an expression."""
        text = "\n    ".join([f"def made({argument}):", *self.lines, f"return {result}"])
        exec(text, self.names)
        return self.names["made"]


def unpacker(part: Any) -> Callable[[Any], tuple | None]:
    """Generates a function that extracts the tensors from arguments of one structure, and returns None for others.

    It is written out for this structure, since small renderings spend most of their time on taking arguments apart.
    """
    source, leaves = Source(), []

    def lay(part: Any, name: str) -> None:
        if isinstance(part, Tensor):
            leaves.append(name)
            return
        kind = source.name(type(part))
        if not isinstance(part, (tuple, list)):
            constant = source.name(part)
            source.lines.append(f"if {name} is not {constant} and (type({name}) is not {kind} or {name} != {constant}): "
                                "return None")
            return
        source.lines.append(f"if type({name}) is not {kind} or len({name}) != {len(part)}: return None")
        items = [f"{name}_{number}" for number in range(len(part))]
        if items:
            source.lines.append(f"{', '.join(items)}, = {name}")
        for item, inner in zip(part, items):
            lay(item, inner)

    lay(part, "p")
    return source.function("p", f"({''.join(leaf + ', ' for leaf in leaves)})")


def assembler(shape: Any) -> Callable[[list[Tensor]], Any]:
    """Generates a function that puts tensors, in order, into the places of `Leaf`s."""
    source, places = Source(), itertools.count()

    def expression(part: Any) -> str:
        if isinstance(part, Leaf):
            return f"r[{next(places)}]"
        if not isinstance(part, (tuple, list)):
            return source.name(part)
        items = "".join(expression(item) + ", " for item in part)
        return f"[{items}]" if isinstance(part, list) else f"new({source.name(type(part))}, ({items}))"

    return source.function("r", expression(shape))
