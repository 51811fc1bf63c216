"""Numbers of lanes that only the device knows: whoever launches kernels goes by the most that there may be."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor


class LaneCount(NamedTuple):
    """A number of lanes that stands on the device."""

    counts: Tensor  # int64, several such numbers
    number: int  # which of them
    most: int  # that it may be

    @property
    def address(self) -> int:
        """Where it stands."""
        return self.counts.data_ptr() + 8 * self.number


    @property
    def alone(self) -> Tensor:
        """(1,) the number, on the device."""
        return self.counts[self.number:self.number + 1]


def most_of(count: int | LaneCount) -> int:
    """What a number of lanes may be at most."""
    return count.most if isinstance(count, LaneCount) else count


def waited_for(count: int | LaneCount) -> int:
    """A number of lanes; waits for the device if it stands there."""
    return int(count.counts[count.number]) if isinstance(count, LaneCount) else count
