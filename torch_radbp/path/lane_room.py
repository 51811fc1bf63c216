"""The room that bounces have for paths where only a device knows how many reach each: that for all, until it is asked."""

from __future__ import annotations

from collections.abc import Sequence

ASKED = 16  # bounces after which a device is asked how many paths are left


def power_of_2(number: int) -> int:
    """The least power of 2 that is not less; 0 of 0. So that there are few kinds of room, for each of which launches are
    prepared."""
    return 1 << (number - 1).bit_length() if number else 0


def room_for(fractions: Sequence[float]) -> list[float]:
    """The shares of the paths that bounces have room for.

    Args:
        fractions: of the paths that reach each depth.
    """
    most = [1.0, *(min(1.0, 2 * fraction) for fraction in fractions[ASKED::ASKED])]
    return [share for share in most for _ in range(ASKED)]
