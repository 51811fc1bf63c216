"""The limits of the size of images."""

from __future__ import annotations

MAX_PIXELS = 2**27  # 16384 x 8192


def check_size(width: int, height: int) -> None:
    """Raises ValueError if an image is empty or too large to be read."""
    if not 0 < width * height <= MAX_PIXELS:
        raise ValueError(f"an image may have 1 to {MAX_PIXELS} pixels, this one has {width} x {height}")
