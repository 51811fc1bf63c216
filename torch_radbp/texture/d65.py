"""The CIE standard illuminant D65 as a texture."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_radbp.plugin import finite, register
from torch_radbp.texture.rgb import RGB


@register("texture", "d65")
class D65(RGB):
    """The CIE standard illuminant D65, which is white in linear sRGB: as in Mitsuba's RGB modes, `scale` times `color`.

    Parameters: `value`, their product, () or (3,). Derivatives: with respect to it.

    Attributes:
        value: the product of `scale` and `color`.

    Args:
        color: one number or three, linear RGB; white if it is not given. Mitsuba takes a texture as well, which it shows as
            it is; here it is refused: put the texture itself into this place.
        scale: a factor.
    """

    instead_of_objects = ("a texture in a d65 is shown as it is in Mitsuba's RGB modes, whatever the scale: put the texture "
                          "itself into this place")

    def __init__(self, *, color: Tensor | float = 1.0, scale: float = 1.0):
        super().__init__(value=finite("color", color).to(torch.get_default_dtype()) * scale)

    color, scale = 1.0, 1.0  # resolved into `value`
