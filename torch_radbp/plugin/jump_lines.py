"""Lines along which the values of a texture are discontinuous."""

from __future__ import annotations

from math import inf
from typing import NamedTuple


class JumpLines(NamedTuple):
    """Parallel lines in the surface coordinates (u, v): where x u + y v + z is an integer."""

    x: float
    y: float
    z: float
    first: float = -inf  # the least of these integers
    last: float = inf  # the greatest
