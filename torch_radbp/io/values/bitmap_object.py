"""Mitsuba's `Bitmap` objects as image arrays."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

GREY, COLOURED = ("Y", "YA"), ("RGB", "RGBA", "XYZ", "XYZA")


def is_bitmap_object(value: Any) -> bool:
    """True for a Mitsuba `Bitmap` of any variant; Mitsuba itself need not be installed."""
    return all(callable(getattr(value, name, None)) for name in ("pixel_format", "srgb_gamma", "convert"))


def linear_values(bitmap: Any, raw: bool) -> Tensor:
    """The values of a Mitsuba `Bitmap`, linear float32, (H, W, 1) or (H, W, 3), without its alpha.

    Integers become fractions, and sRGB is decoded where the bitmap says that it has it (8 bits, unless told otherwise).

    Args:
        bitmap: left as it is.
        raw: as of the texture `bitmap`: do not decode sRGB.

    Raises:
        ValueError: on bitmaps of other pixel formats.
    """
    pixel_format = bitmap.pixel_format().name
    if pixel_format not in (*GREY, *COLOURED):
        raise ValueError(f"a Bitmap must have one of the pixel formats {', '.join((*GREY, *COLOURED))}, got {pixel_format}")
    wanted = bitmap.PixelFormat.Y if pixel_format in GREY else bitmap.PixelFormat.RGB
    converted = bitmap.convert(pixel_format=wanted, component_format=bitmap.Float32,
                               srgb_gamma=raw and bitmap.srgb_gamma())
    values = np.array(converted, dtype=np.float32)
    return torch.from_numpy(values.reshape(*values.shape[:2], -1))
