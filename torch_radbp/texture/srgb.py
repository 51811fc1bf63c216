"""A constant colour, Mitsuba's plugin `srgb`."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_radbp.plugin import finite, register
from torch_radbp.plugin.domain import FRACTION
from torch_radbp.texture.rgb import RGB


@register("texture", "srgb")
class SRGB(RGB):
    """A constant linear RGB value, which <rgb> becomes in Mitsuba.

    Parameters: `value`, () or (3,). Derivatives: with respect to it.

    Attributes:
        value: the colour.

    Args:
        color: one number or three, linear RGB.
        unbounded: values above 1 are allowed.

    Raises:
        ValueError: if a value is above 1 and not allowed.
    """

    def __init__(self, *, color: Tensor | float, unbounded: bool = False):
        value = finite("color", color).to(torch.get_default_dtype())
        if not unbounded:
            FRACTION.check("color", value)
        super().__init__(value=value)

    color, unbounded = None, False  # resolved into `value`
