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

Result = TypeVar("Result")


class TooFewRepetitions(Exception):
    """Error: lanes went on after the last repetition, so that what was computed is of no use."""


class Repetitions(NamedTuple):
    """The repetitions in sequences of launches."""

    most: int
    left: list[Tensor]  # (1,) int64 each, of the lanes that went on after the last; added to

    def none_is_left(self) -> Tensor | None:
        """() bool on the device, whether none went on; None: nothing was repeated."""
        return torch.cat(self.left).sum() == 0 if self.left else None


@dataclass
class LearntRepetitions:
    """The number of repetitions that has sufficed so far."""

    most: int = 3  # with the first segment of a way that makes 4: into a medium, through it, and to what is behind

    def enough(self, work: Callable[[Repetitions], Result]) -> Result:
        """The result of `work`, which raises `TooFewRepetitions` if those that it is given are not enough."""
        while True:
            most = self.most
            try:
                return work(Repetitions(most, []))
            except TooFewRepetitions:
                self.most = max(self.most, 2 * most + 1)


def read_together(flags: Sequence[Tensor], repetitions: Repetitions | None = None) -> list[bool]:
    """Flags, () bool each on one device, which is waited for once; and whether what was repeated has come to its end.

    Raises:
        TooFewRepetitions: if it has not.
    """
    finished = None if repetitions is None else repetitions.none_is_left()
    found = [*flags, *([] if finished is None else [finished])]
    answers = torch.stack(found).tolist() if len(found) > 1 else [bool(flag) for flag in found]
    if finished is not None and not answers.pop():
        raise TooFewRepetitions
    return answers
