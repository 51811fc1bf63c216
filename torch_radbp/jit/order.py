"""Operations that only move data: lanes into queues, entries to indices.

How it is done is the target's: `cpu_order.py` for the processor, `nvptx_lanes.py` for GPUs, torch elsewhere.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from torch_radbp.jit.target import target_of


def chosen(flags: Tensor) -> Tensor:
    """The lanes, (M,) int32, whose flag in `flags`, (N,) bool, is set."""
    return target_of(flags.device).chosen(flags)


def inverted(flags: Tensor) -> Tensor:
    """Inverts flags, (N,) bool."""
    return target_of(flags.device).inverted(flags)


def nothing(flags: Tensor) -> Tensor:
    """Flags of the same number that are all false."""
    return target_of(flags.device).nothing(flags)


def partition(number: Tensor, queues: int) -> tuple[Tensor, Sequence[int]]:
    """Sorts lanes into queues.

    Args:
        number: (N,) bool or integers from 0 to `queues` - 1, which is not checked: the queue of each lane.

    Returns:
        (N,) int32, the lanes of queue 0 in their order, then those of queue 1, ...; and the number of lanes of each queue.
    """
    return target_of(number.device).partition(number, queues)


def in_order(major: Tensor, minor: Tensor, queues: int) -> tuple[Tensor, Tensor, Tensor]:
    """Sorts lanes by one number and, where that is equal, by another; stable.

    Args:
        major, minor: (N,) int32 from 0 to `queues` - 1, which is not checked; `queues` is at least 1.

    Returns:
        (N,) int32 the lanes; and both numbers in this order.
    """
    return target_of(major.device).in_order(major, minor, queues)


def put(targets: Sequence[Tensor], place: Tensor, entries: Sequence[Tensor]) -> None:
    """Scatters entries into tensors, overwriting.

    Args:
        targets: (K,) each, contiguous, written into.
        place: (N,) int32, tells no place twice; that it is inside is not checked.
        entries: (N,) of each target, of its dtype.

    Raises:
        ValueError: if lengths, dtypes or devices do not go together.
    """
    lanes = place.numel()
    if place.dtype != torch.int32:
        raise ValueError(f"places are int32, got {place.dtype}")
    for target, entry in zip(targets, entries, strict=True):
        if entry.numel() != lanes or entry.dtype != target.dtype or not target.is_contiguous():
            raise ValueError(f"{lanes} entries of {target.dtype} are put into a contiguous tensor, got {entry.numel()} of "
                             f"{entry.dtype}")
        if not target.device == entry.device == place.device:
            raise ValueError(f"entries on {entry.device} are put into a tensor on {target.device} at places on "
                             f"{place.device}; all must lie on one device")
    if lanes:
        target_of(place.device).put(targets, place.contiguous(), [entry.contiguous() for entry in entries])
