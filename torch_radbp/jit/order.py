"""Operations that only move data: lanes into queues, entries to indices.

How it is done is the target's: `cpu/cpu_order.py` for the processor, `nvidia/nvptx_lanes.py` for GPUs, torch elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from torch_radbp.jit.recording.recording import Recording, recording
from torch_radbp.jit.target import Target, target_of


def mover(lanes: Tensor) -> Target | Recording:
    """The object that moves lanes about: the target of the lanes' device, or the recording that listens to this thread."""
    return recording() or target_of(lanes.device)


def chosen(flags: Tensor) -> Tensor:
    """The lanes, (M,) int32, of which `flags`, (N,) bool, are true."""
    return mover(flags).chosen(flags)


def inverted(flags: Tensor) -> Tensor:
    """The negation of `flags`, (N,) bool."""
    return mover(flags).inverted(flags)


def nothing(flags: Tensor) -> Tensor:
    """(N,) bool, false for every lane of `flags`."""
    return mover(flags).nothing(flags)


def partition(number: Tensor, queues: int) -> tuple[Tensor, Sequence[int]]:
    """Sorts lanes into queues.

    Args:
        number: (N,) bool or integers from 0 to `queues` - 1, which is not checked: the queue of each lane.

    Returns:
        (N,) int32, the lanes of queue 0 in their order, then those of queue 1, ...; and the number of lanes of each queue.
    """
    return mover(number).partition(number, queues)


def in_order(major: Tensor, minor: Tensor, queues: int) -> tuple[Tensor, Tensor, Tensor]:
    """Sorts lanes by one number and, where that is equal, by another; stable.

    Args:
        major, minor: (N,) int32 from 0 to `queues` - 1, which is not checked; `queues` is at least 1.

    Returns:
        (N,) int32 the lanes; and both numbers in this order.
    """
    return target_of(major.device).in_order(major, minor, queues)


def repeated(lanes: Tensor, function: Callable[[Tensor], Tensor]) -> None:
    """Calls a function with some lanes, then with those that it returns, until it returns none.

    Args:
        lanes: (M,) int32.
        function: takes lanes, and returns those of them that go on. Its results are kept only if they are written into
            tensors that existed before.
    """
    if (listener := recording()) is not None:
        listener.repeated(lanes, function)
        return
    while len(lanes):
        lanes = function(lanes)


def duplicated(tensor: Tensor) -> Tensor:
    """A copy of a tensor of lanes that carries no derivative."""
    listener = recording()
    return tensor.clone() if listener is None else listener.duplicated(tensor)


def all_lanes(like: Tensor) -> Tensor:
    """(N,) int32, all lanes of a tensor."""
    listener = recording()
    if listener is not None:
        return listener.all_lanes(like)
    return torch.arange(len(like), dtype=torch.int32, device=like.device)


def put(targets: Sequence[Tensor], place: Tensor, entries: Sequence[Tensor]) -> None:
    """Scatters entries into tensors, overwriting.

    Args:
        targets: (K,) each, contiguous, written into.
        place: (N,) int32, without duplicates; that it is inside of the targets is not checked.
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
        mover(place).put(targets, place.contiguous(), [entry.contiguous() for entry in entries])
