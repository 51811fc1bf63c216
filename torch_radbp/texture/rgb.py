"""A constant colour."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor, nn

from torch_radbp.domain import Domain
from torch_radbp.lookup import lookup
from torch_radbp.plugin import BSDF, Plugin, Texture, finite, register
from torch_radbp.texture.neural import NeuralTexture
from torch_radbp.texture.reader import TableReader
from torch_radbp.vec import Vec2, Vec3


@dataclass(frozen=True)
class ColourReader(TableReader):
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


def as_texture(owner: Plugin, name: str, value: Texture | nn.Module | Tensor | float) -> Texture:
    """The texture for the attribute `name` of a plugin, from a texture, a module, one number or three.

    Raises:
        TypeError: if the value is of another type, or a module where only tables can stand.
        ValueError: if a texel is not in the attribute's domain.
    """
    if isinstance(value, (str, bytes, dict)):
        raise TypeError(f"{name} must be a number, three numbers or a texture, got {value!r}")
    if isinstance(value, nn.Module) and not isinstance(value, Texture):
        value = NeuralTexture(value)
    texture = value if isinstance(value, Texture) else RGB(value=value)
    if texture.tabulated:
        owner.domains()[name].check(name, texture.texels())
    elif not isinstance(owner, BSDF):
        raise TypeError(f"{name} of {type(owner).__name__} must be a colour or a bitmap, got a {type(texture).__name__}: a "
                        f"module can stand in the place of every texture of a material, and of no other so far")
    return texture
