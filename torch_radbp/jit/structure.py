"""Nested tuples and lists of tensors, taken apart and put together again; what is no tensor belongs to the structure."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import zip_longest
from typing import Any

import torch
from torch import Tensor


def flatten(part: Any, leaves: list[Tensor], key: list) -> None:
    """Collects the tensors of nested tuples and lists, and a key that tells structures apart.

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
    """The key of the same structure with tensors that have an entry per lane."""
    return tuple((item[0], 1) if isinstance(item[0], torch.dtype) else item for item in key)


def difference(key: Sequence, other: Sequence) -> tuple[str, str]:
    """The first difference of two structures, in words for a message."""
    return next((described(a), described(b)) for a, b in zip_longest(key, other) if a != b)


def described(item: tuple | None) -> str:
    """One item of a key in words."""
    if item is None:
        return "nothing"
    kind, value = item
    if isinstance(kind, torch.dtype):
        return f"{str(kind).removeprefix('torch.')} of {value} dimensions"
    return f"{kind.__name__} of {value}" if issubclass(kind, (tuple, list)) else repr(value)


def replaced(part: Any, next_leaf: Callable[[], Tensor]) -> Any:
    """The same nested tuples with other tensors, which `next_leaf` gives in order."""
    if isinstance(part, Tensor):
        return next_leaf()
    if isinstance(part, (tuple, list)):
        items = [replaced(item, next_leaf) for item in part]
        return type(part)(*items) if hasattr(part, "_fields") else type(part)(items)
    return part


def assembler(part: Any, leaves: list[Tensor]) -> Callable[[list[Tensor]], Any]:
    """Collects the tensors of nested tuples and lists, and returns the function that puts others in their places."""
    if isinstance(part, Tensor):
        place = len(leaves)
        leaves.append(part)
        return lambda results: results[place]
    if not isinstance(part, (tuple, list)):
        return lambda results: part
    items = [assembler(item, leaves) for item in part]
    make = part._make if hasattr(part, "_fields") else type(part)
    return lambda results: make([item(results) for item in items])
