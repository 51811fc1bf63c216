"""Nested tuples of tensors, taken apart and put together again; what is no tensor belongs to the structure."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from torch import Tensor


def flatten(part: Any, leaves: list[Tensor], key: list) -> None:
    """Collects the tensors of nested tuples, and a key that tells structures apart.

    Args:
        part: tensors and anything hashable in nested tuples, named or not.
        leaves: the tensors are added, in order.
        key: hashable values are added; equal keys have equal structure, dtypes and constants.
    """
    if isinstance(part, Tensor):
        key.append((part.dtype, part.dim()))
        leaves.append(part)
    elif isinstance(part, tuple):
        key.append((type(part), len(part)))
        for item in part:
            flatten(item, leaves, key)
    else:
        key.append((type(part), part))


def replaced(part: Any, next_leaf: Callable[[], Tensor]) -> Any:
    """The same nested tuples with other tensors, which `next_leaf` gives in order."""
    if isinstance(part, Tensor):
        return next_leaf()
    if isinstance(part, tuple):
        items = [replaced(item, next_leaf) for item in part]
        return type(part)(*items) if hasattr(part, "_fields") else tuple(items)
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
