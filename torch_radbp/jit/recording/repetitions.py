"""How often a sequence of launches repeats what is done for some lanes until none goes on.

A host that shall not wait does not know when that is so. So it is repeated a number of times, and how many lanes went on
after the last is found out when the host waits anyway, in the end. If there were any, everything is done once more, with
more repetitions; from then on there are so many.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

import torch
from torch import Tensor

from torch_radbp.jit.recording.lane_count import LaneCount
from torch_radbp.tensors.asked_later import answered, asked_together

Result = TypeVar("Result")


class TooFewRepetitions(Exception):
    """Error: lanes went on after the last repetition, so that what was computed is of no use."""


class Repetitions(NamedTuple):
    """The number of times that launches repeat an operation, and how many lanes went on after the last time."""

    most: int
    left: list[Tensor]  # (1,) int64 each, of the lanes that went on after the last; added to

    def add(self, left: Sequence[int | LaneCount]) -> None:
        """Adds numbers of lanes that went on after the last repetition.

        Raises:
            TooFewRepetitions: if one that the host knows is not 0.
        """
        known = [number for number in left if isinstance(number, int)]
        if any(known):
            raise TooFewRepetitions
        self.left.extend([number.alone for number in left if isinstance(number, LaneCount)])


@dataclass
class LearntRepetitions:
    """The number of repetitions that has sufficed so far."""

    most: int = 3  # with the first segment of a way that makes 4: into a medium, through it, and to what is behind

    def enough(self, work: Callable[[Repetitions], Result]) -> Result:
        """Calls `work` with ever more repetitions until it raises no `TooFewRepetitions`, and returns its result."""
        while True:
            most = self.most
            try:
                with asked_together():
                    return work(Repetitions(most, []))
            except TooFewRepetitions:
                self.most = max(self.most, 2 * most + 1)


    def found_out(self, work: Callable[[Repetitions], Result]) -> Result:
        """Calls `work` with ever more repetitions until no lane goes on after them, and returns its result."""
        def asked(some: Repetitions) -> Result:
            result = work(some)
            read_together([], some)
            return result

        return self.enough(asked)


def read_together(flags: Sequence[Tensor], repetitions: Repetitions | None = None) -> bool:
    """True if all flags, () each on one device, are true; waits for the device once, for these and all pending questions.

    Raises:
        TooFewRepetitions: if lanes went on after the last repetition.
    """
    left = [torch.cat(repetitions.left).sum()] if repetitions is not None and repetitions.left else []
    found = answered([*flags, *left], lambda numbers: not left or not numbers[-1])
    if left and found.pop():
        raise TooFewRepetitions
    return all(found)
