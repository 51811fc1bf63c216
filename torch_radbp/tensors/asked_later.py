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
    """Error: something is not as it was presumed, so that what was computed is of no use."""


class Inquiry(NamedTuple):
    """Numbers that are to be fetched, and what is done with them then, which may raise."""

    numbers: Tensor  # (K,) on a device
    then: Callable[[list[float]], None]


class _ThreadState(threading.local):
    """Thread-local state: the questions that wait, of each context; outside of any they are asked at once."""

    waiting: tuple[list[Inquiry], ...] = ()
    presumes = False


HERE = _ThreadState()


def asked_later(numbers: Tensor, then: Callable[[list[float]], None]) -> None:
    """Calls `then` with numbers, (K,): at once, if the host knows them or nobody will ask; else in the end."""
    if numbers.is_cpu or not HERE.waiting:
        then(numbers.tolist())
    else:
        HERE.waiting[-1].append(Inquiry(numbers, then))


@contextmanager
def asked_together() -> Iterator[None]:
    """A context in which questions of this thread wait; those that nobody has answered meanwhile are asked at its end."""
    before, own = HERE.waiting, []
    HERE.waiting = (*before, own)
    try:
        yield
        if own:
            answered()
    finally:
        HERE.waiting = before


def answered(more: Sequence[Tensor] = (), counts: Callable[[list[float]], bool] = lambda numbers: True) -> list[float]:
    """Fetches numbers by one transfer, and does with those that wait what is to be done; none waits afterwards.

    Args:
        more: other numbers, of any shape; they are returned one after the other.
        counts: of these, whether those that wait in the innermost context are of any use.
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
    """True if this thread may presume what it does not know; see `Presumptions`."""
    return HERE.presumes


def presumed(flag: Tensor, presumption: bool) -> bool:
    """A flag, () bool: as it is, if the host knows it or may not presume; else as presumed, to be found out in the end."""
    if flag.is_cpu or not presuming():
        return bool(flag)
    mistaken_if_any(flag != presumption)
    return presumption


def mistaken_if_any(differ: Tensor) -> None:
    """What was presumed is wrong if any of some flags or counts, of whatever shape, is not 0; found out in the end."""
    def told(numbers: list[float]) -> None:
        if numbers[0]:
            raise Mistaken

    asked_later(differ.any().reshape(1), told)


@dataclass
class Presumptions:
    """Whether somebody who was never mistaken may presume what is nearly always so; who was is not to be mistaken again."""

    mistaken: bool = False

    def tried(self, work: Callable[[], Result], forget: Callable[[], None]) -> Result:
        """What `work` returns, which may presume; it is done once more, by answers, if something was not as presumed.

        Args:
            work: leaves nothing behind that is wrong if a presumption is, but for what `forget` forgets.
            forget: is called before `work` is done once more.
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
