"""Records, that is nested tuples, named or not, lists and dicts: their leaves in order, and the same with other leaves.

Leaves are counted as `torch.utils._pytree` counts them (None is one, an empty tuple has none), which takes five times as
long: it looks each type up in a registry, and a small rendering spent a fifth of its time there.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import torch
from torch import Tensor

NESTED = (tuple, list, dict)


def leaves_of(record: Any) -> list:
    """Whatever is no tuple, list or dict in a record, in order."""
    leaves: list = []
    collect((record,), leaves)
    return leaves


def collect(record: tuple | list | dict, leaves: list) -> None:
    """Adds the leaves of a record to a list."""
    for part in record.values() if isinstance(record, dict) else record:
        if isinstance(part, NESTED):
            collect(part, leaves)
        else:
            leaves.append(part)


def with_leaves(record: Any, leaves: Iterable) -> Any:
    """A record of the same structure with other leaves, given in order."""
    return rebuilt((record,), iter(leaves))[0]


def rebuilt(record: tuple | list | dict, leaves: Iterator) -> tuple | list | dict:
    """As `with_leaves`, of a part of the record that has parts itself."""
    if isinstance(record, dict):
        return dict(zip(record, rebuilt(tuple(record.values()), leaves)))
    parts = [rebuilt(part, leaves) if isinstance(part, NESTED) else next(leaves) for part in record]
    return parts if isinstance(record, list) else tuple.__new__(type(record), parts)


def rows_between(record, first: int, last: int):
    """The rows from `first` to before `last` of every tensor of a record, in nested tuples; None stays None."""
    if record is None or isinstance(record, Tensor):
        return None if record is None else record[first:last]
    return tuple.__new__(type(record), [rows_between(part, first, last) for part in record])


def joined(parts: list):
    """Records of the same structure, one after the other."""
    if len(parts) == 1:
        return parts[0]
    if isinstance(parts[0], Tensor):
        return torch.cat(parts)
    return None if parts[0] is None else tuple.__new__(type(parts[0]), [joined(list(column)) for column in zip(*parts)])
