"""Numbers on a device that the host needs, but not at once: they are fetched together, when it waits anyway."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import NamedTuple

import torch
from torch import Tensor


class Inquiry(NamedTuple):
    """Numbers that are to be fetched, and what is done with them then, which may raise."""

    numbers: Tensor  # (K,) on a device
    then: Callable[[list[float]], None]


class _ThreadState(threading.local):
    """Thread-local state: the questions that wait; None: they are asked at once."""

    waiting: list[Inquiry] | None = None


HERE = _ThreadState()


def asked_later(numbers: Tensor, then: Callable[[list[float]], None]) -> None:
    """Calls `then` with numbers, (K,): at once, if the host knows them or nobody will ask; else in the end."""
    if numbers.is_cpu or HERE.waiting is None:
        then(numbers.tolist())
    else:
        HERE.waiting.append(Inquiry(numbers, then))


@contextmanager
def asked_together() -> Iterator[None]:
    """A context in which questions of this thread wait; those that nobody has answered meanwhile are asked at its end."""
    before, HERE.waiting = HERE.waiting, []
    try:
        yield
        answered()
    finally:
        HERE.waiting = before


def answered(more: Sequence[Tensor] = (), counts: Callable[[list[float]], bool] = lambda numbers: True) -> list[float]:
    """Fetches numbers by one transfer, and does with those that wait what is to be done; none waits afterwards.

    Args:
        more: other numbers, () each; they are returned.
        counts: of these, whether the others are of any use.
    """
    questions = HERE.waiting
    if not questions:
        return torch.stack([each.double() for each in more]).tolist() if len(more) > 1 else [each.item() for each in more]
    HERE.waiting = []
    parts = [*(number.reshape(1) for number in more), *(question.numbers for question in questions)]
    numbers = torch.cat([part.double() for part in parts]).tolist()
    given, numbers = numbers[:len(more)], numbers[len(more):]
    for asked, then in questions if counts(given) else ():
        then(numbers[:len(asked)])
        numbers = numbers[len(asked):]
    return given
