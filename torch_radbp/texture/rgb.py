"""A constant colour."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_radbp.domain import Domain
from torch_radbp.plugin import Plugin, Texture, finite, register


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

    def domains(self) -> dict[str, Domain]:
        return {"value": Domain(shapes=((), (3,)))}

    def texels(self) -> Tensor:
        """(1, 1, 3) linear RGB, attached."""
        return self.value.expand(3).reshape(1, 1, 3)

    def scalars(self) -> Tensor:
        """The value as a number, (1, 1): the mean of the channels, as in Mitsuba; attached."""
        return self.value.mean().reshape(1, 1)


def as_texture(owner: Plugin, name: str, value: Texture | Tensor | float) -> Texture:
    """The texture for the attribute `name` of a plugin, from a texture, one number or three.

    Raises:
        TypeError: if the value is of another type.
        ValueError: if a texel is not in the attribute's domain.
    """
    if isinstance(value, (str, bytes, dict)):
        raise TypeError(f"{name} must be a number, three numbers or a texture, got {value!r}")
    texture = value if isinstance(value, Texture) else RGB(value=value)
    owner.domains()[name].check(name, texture.texels())
    return texture
