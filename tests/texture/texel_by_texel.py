"""Values of bitmaps, texel by texel."""

from __future__ import annotations

import numpy as np

HEIGHT, WIDTH = 3, 4


def wrapped(texel: int, size: int, mode: str) -> int:
    if mode == "repeat":
        return texel % size
    if mode == "clamp":
        return min(max(texel, 0), size - 1)
    folded = texel % (2 * size)
    return folded if folded < size else 2 * size - 1 - folded


def reference(data: np.ndarray, u: float, v: float, mode: str, nearest: bool) -> np.ndarray:
    """The value at one place, texel by texel."""
    def texel(column, row):
        return data[wrapped(row, HEIGHT, mode), wrapped(column, WIDTH, mode)]

    x, y = u * WIDTH, v * HEIGHT
    if nearest:
        return texel(int(np.floor(x)), int(np.floor(y)))
    left, top = int(np.floor(x - 0.5)), int(np.floor(y - 0.5))
    fx, fy = x - 0.5 - left, y - 0.5 - top
    return ((1 - fy) * ((1 - fx) * texel(left, top) + fx * texel(left + 1, top))
            + fy * ((1 - fx) * texel(left, top + 1) + fx * texel(left + 1, top + 1)))
