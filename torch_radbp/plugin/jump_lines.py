"""Lines along which the values of a texture are discontinuous."""

from __future__ import annotations

from math import inf
from typing import NamedTuple

from torch import Tensor


class JumpLines(NamedTuple):
    """Parallel lines in the surface coordinates (u, v): where x u + y v + z is an integer."""

    x: float
    y: float
    z: float
    first: float = -inf  # the integers are not less
    last: float = inf  # nor greater
    moving: Tensor | None = None  # () z, attached, where the lines move over the surface; None: they do not
