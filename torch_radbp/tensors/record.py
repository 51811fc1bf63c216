"""Records, that is nested tuples (named or not), lists and dicts: their leaves in order, and copies with other leaves.

Leaves are counted as `torch.utils._pytree` counts them (None is one, an empty tuple has none), which takes five times as
long: it looks each type up in a registry, and a small rendering spent a fifth of its time there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import torch
from torch import Tensor

NESTED = (tuple, list, dict)


def leaves_of(record: Any) -> list:
    """The leaves of a record in order: all that is no tuple, list or dict."""
    leaves: list = []
    collect((record,), leaves)
    return leaves


def collect(record: tuple | list | dict, leaves: list) -> None:
    """Appends the leaves of a record to a list."""
    for part in record.values() if isinstance(record, dict) else record:
        if part is None or type(part) is Tensor or not isinstance(part, NESTED):  # from the most frequent to the rarest
            leaves.append(part)
        else:
            collect(part, leaves)


def tensors_in(record: Any) -> list[Tensor]:
    """The tensors among the leaves of a record, in order."""
    tensors: list[Tensor] = []
    collect_tensors((record,), tensors)
    return tensors


def collect_tensors(record: tuple | list | dict, tensors: list[Tensor]) -> None:
    """Appends the tensors of a record to a list."""
    for part in record.values() if isinstance(record, dict) else record:
        if type(part) is Tensor:
            tensors.append(part)
        elif part is not None:
            if isinstance(part, NESTED):
                collect_tensors(part, tensors)
            elif isinstance(part, Tensor):
                tensors.append(part)


def with_leaves(record: Any, leaves: Iterable) -> Any:
    """A record of the same structure with other leaves, given in order."""
    left = iter(leaves)
    return mapped(record, lambda leaf: next(left))


def mapped(record: Any, function: Callable[[Any], Any]) -> Any:
    """A record of the same structure whose leaves are `function` of the leaves."""
    kind = type(record)
    if kind is Tensor or not isinstance(record, NESTED):
        return function(record)
    if isinstance(record, dict):
        return {key: mapped(part, function) for key, part in record.items()}
    parts = [function(part) if part is None or type(part) is Tensor else mapped(part, function) for part in record]
    return parts if isinstance(record, list) else tuple.__new__(kind, parts)


def with_parts(record: tuple | list | dict, parts: list) -> tuple | list | dict:
    """A tuple, list or dict of the same type with other items."""
    if isinstance(record, dict):
        return dict(zip(record, parts))
    return parts if isinstance(record, list) else tuple.__new__(type(record), parts)


def selected(mask: Tensor, a: Any, b: Any) -> Any:
    """`torch.where` for tensors or records of tensors; None stays None."""
    if isinstance(a, tuple):
        return with_parts(a, [selected(mask, *parts) for parts in zip(a, b)])
    return None if a is None else torch.where(mask, a, b)


def rows_between(record, first: int, last: int):
    """The rows from `first` to before `last` of every tensor of a record; None stays None."""
    if record is None or isinstance(record, Tensor):
        return None if record is None else record[first:last]
    return tuple.__new__(type(record), [rows_between(part, first, last) for part in record])


def joined(parts: list):
    """Concatenates records of the same structure, tensor by tensor."""
    if len(parts) == 1:
        return parts[0]
    if isinstance(parts[0], Tensor):
        return torch.cat(parts)
    return None if parts[0] is None else tuple.__new__(type(parts[0]), [joined(list(column)) for column in zip(*parts)])
