"""Numbers on a device that the host needs, but not at once: they are fetched together, when it waits anyway.

What the host must know to go on it may presume, if it is nearly always so: that nobody has written into a tensor that torch
knows no writing of, that a sky is not black. It finds out in the end, and if it was wrong does all once more, by answers.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

import torch
from torch import Tensor

Result = TypeVar("Result")


class Mistaken(Exception):
    """Error: a presumption was wrong, so that what was computed by it is of no use."""


class Inquiry(NamedTuple):
    """Numbers that are to be fetched from a device, with the function that is then called with them, and may raise."""

    numbers: Tensor  # (K,) on a device
    then: Callable[[list[float]], None]


class _ThreadState(threading.local):
    """Thread-local state: the inquiries that wait in each context of `asked_together`."""

    waiting: tuple[list[Inquiry], ...] = ()
    presumes = False


HERE = _ThreadState()


def asked_later(numbers: Tensor, then: Callable[[list[float]], None]) -> None:
    """Calls `then` with numbers, (K,): at once on the CPU or outside of `asked_together`, else when they are fetched."""
    if numbers.is_cpu or not HERE.waiting:
        then(numbers.tolist())
    else:
        HERE.waiting[-1].append(Inquiry(numbers, then))


@contextmanager
def asked_together() -> Iterator[None]:
    """A context in which this thread's inquiries wait until `answered` or the context's end fetches all by one transfer."""
    before, own = HERE.waiting, []
    HERE.waiting = (*before, own)
    try:
        yield
        if own:
            answered()
    finally:
        HERE.waiting = before


def answered(more: Sequence[Tensor] = (), counts: Callable[[list[float]], bool] = lambda numbers: True) -> list[float]:
    """Fetches `more` and the numbers of all waiting inquiries by one transfer, and calls the inquiries' functions.

    Args:
        more: other numbers, of any shape; they are returned one after the other.
        counts: a function of these numbers; if it is false, the inquiries of the innermost context are dropped.
    """
    levels = [list(level) for level in HERE.waiting]
    if not any(levels):
        return torch.cat([each.double().reshape(-1) for each in more]).tolist() if more else []
    for level in HERE.waiting:
        level.clear()
    questions = [question for level in levels for question in level]
    parts = [*(number.reshape(-1) for number in more), *(question.numbers for question in questions)]
    numbers = torch.cat([part.double() for part in parts]).tolist()
    first = sum([number.numel() for number in more])
    given, numbers = numbers[:first], numbers[first:]
    for asked, then in questions if counts(given) else questions[:-len(levels[-1]) or None]:
        then(numbers[:len(asked)])
        numbers = numbers[len(asked):]
    return given


def presuming() -> bool:
    """True if this thread may presume values of flags that only the device knows, and go on; they are checked later."""
    return HERE.presumes


def presumed(flag: Tensor, presumption: bool) -> bool:
    """A flag, () bool: read at once on the CPU or where nothing may be presumed; else as presumed, and checked later."""
    if flag.is_cpu or not presuming():
        return bool(flag)
    mistaken_if_any(flag != presumption)
    return presumption


def mistaken_if_any(differ: Tensor) -> None:
    """Raises `Mistaken`, when inquiries are answered, if any of some flags or counts, of whatever shape, is not 0."""
    def told(numbers: list[float]) -> None:
        if numbers[0]:
            raise Mistaken

    asked_later(differ.any().reshape(1), told)


@dataclass
class Presumptions:
    """Lets a caller go on by presumed values of flags that only a device knows, as long as none of them was wrong."""

    mistaken: bool = False

    def tried(self, work: Callable[[], Result], forget: Callable[[], None]) -> Result:
        """The result of `work`, which may presume flags; if one was mistaken, it is called again without presumptions.

        Args:
            work: after a wrong presumption all that it leaves behind is either right or dropped by `forget`.
            forget: called before `work` is called again.
        """
        if self.mistaken or HERE.presumes:
            return work()
        HERE.presumes = True
        try:
            with asked_together():
                try:
                    return work()
                except Mistaken:
                    raise
                except Exception:
                    answered()  # which may tell why
                    raise
        except Mistaken:
            self.mistaken = True
        finally:
            HERE.presumes = False
        forget()
        return work()
