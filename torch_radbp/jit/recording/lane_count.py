"""Numbers of lanes that only the device knows: whoever launches kernels goes by the most that there may be."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor


class LaneCount(NamedTuple):
    """A number of lanes that only the device knows, in a tensor there."""

    counts: Tensor  # int64, several such numbers
    number: int  # which of them
    most: int  # that it may be

    @property
    def address(self) -> int:
        """The address of the number on the device."""
        return self.counts.data_ptr() + 8 * self.number


    @property
    def alone(self) -> Tensor:
        """(1,) the number of lanes, a tensor on the device."""
        return self.counts[self.number:self.number + 1]


def most_of(count: int | LaneCount) -> int:
    """The greatest value that a number of lanes may have."""
    return count.most if isinstance(count, LaneCount) else count


def waited_for(count: int | LaneCount) -> int:
    """A number of lanes as an int; waits for the device if only that knows it."""
    return int(count.counts[count.number]) if isinstance(count, LaneCount) else count
