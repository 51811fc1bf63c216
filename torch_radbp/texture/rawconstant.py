"""A constant without colour management."""

from __future__ import annotations

from torch import Tensor

from torch_radbp.plugin import register
from torch_radbp.texture.rgb import RGB


@register("texture", "rawconstant")
class RawConstant(RGB):
    """One number or three, used as they are everywhere.

    Parameters: `value`, () or (3,). Derivatives: with respect to it.

    Args:
        value: one number, or three.
    """

    def __init__(self, *, value: Tensor):
        super().__init__(value=value)
