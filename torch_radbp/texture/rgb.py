"""A constant colour."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_radbp.plugin import Texture, finite, register


@register("texture", "rgb")
class RGB(Texture):
    """The same linear RGB value everywhere.

    Parameters: `value`, (3,) or () for grey. Derivatives: with respect to `value`.

    Raises:
        ValueError: if `value` is neither one nor three finite numbers.
    """

    def __init__(self, *, value: Tensor):
        super().__init__()
        value = finite("value", value).to(torch.get_default_dtype())
        if value.shape not in ((), (3,)):
            value = value.squeeze()
        if value.shape not in ((), (3,)):
            raise ValueError(f"value must be one number or three (linear RGB), got shape {tuple(value.shape)}")
        self.freeze("value", value)

    def texels(self) -> Tensor:
        """(1, 1, 3) linear RGB, attached."""
        return self.value.expand(3).reshape(1, 1, 3)

    def scalars(self) -> Tensor:
        """(1, 1) the value where a number is wanted: the mean of the channels, as in Mitsuba; attached."""
        return self.value.mean().reshape(1, 1)


def as_texture(name: str, value: Texture | Tensor | float) -> Texture:
    """A texture from what an attribute accepts: a texture, one number, or three."""
    if isinstance(value, Texture):
        return value
    if isinstance(value, (str, bytes, dict)):
        raise TypeError(f"{name} must be a number, three numbers or a texture, got {value!r}")
    return RGB(value=value)


def check_range(name: str, texture: Texture, upper: float = float("inf")) -> Texture:
    """The texture, checked to have no texel below 0 or above `upper`."""
    low, high = float(texture.texels().min()), float(texture.texels().max())
    if low < 0 or high > upper:
        limits = f"in [0, {upper:g}]" if upper < float("inf") else "at least 0"
        raise ValueError(f"{name} must be {limits}, got {low if low < 0 else high:g}")
    return texture
