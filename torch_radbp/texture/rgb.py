"""A constant colour."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from torch_radbp.domain import Domain
from torch_radbp.lookup import lookup
from torch_radbp.plugin import Plugin, Texture, finite, register
from torch_radbp.texture.reader import Reader
from torch_radbp.vec import Vec2, Vec3


@dataclass(frozen=True)
class ColourReader(Reader):
    """Reads constant colours. Bank: (R,) linear RGB."""

    needs_uv: ClassVar[bool] = False

    def bank(self, textures: Sequence[Texture], dtype: torch.dtype, device: torch.device) -> Vec3:
        colours = [texture.texels().reshape(3) for texture in textures]
        return Vec3.of(torch.stack(colours).to(dtype=dtype, device=device))

    def read(self, bank: Vec3, row: Tensor, uv: Vec2 | None) -> Vec3:
        return lookup(bank, row)


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

    def reader(self) -> ColourReader:
        """How lanes read it."""
        return ColourReader()

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
