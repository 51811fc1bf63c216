"""The room that bounces have for paths where only a device knows how many reach each: that for all, until it is asked."""

from __future__ import annotations

from collections.abc import Sequence

ASKED = 16  # bounces after which a device is asked how many paths are left


def power_of_2(number: int) -> int:
    """The least power of 2 that is not less than a number; 0 of 0. It serves as tensor size, so that these are few."""
    return 1 << (number - 1).bit_length() if number else 0


def room_for(fractions: Sequence[float]) -> list[float]:
    """For each bounce, the fraction of all paths for which there is memory.

    Args:
        fractions: of all paths, those that reach each depth.
    """
    most = [1.0, *(min(1.0, 2 * fraction) for fraction in fractions[ASKED::ASKED])]
    return [share for share in most for _ in range(ASKED)]
