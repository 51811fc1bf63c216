"""The base of textures of one constant colour."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from torch_radbp.interface.texture import TableReader, TexturePoint
from torch_radbp.plugin import Texture
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.vec import Vec2, Vec3


@dataclass(frozen=True)
class ColourReader(TableReader):
    """Looks constant colours up, for lanes. Bank (table of R textures): (R,) linear RGB."""

    needs_uv: ClassVar[bool] = False

    def bank(self, textures: Sequence[Texture], dtype: torch.dtype, device: torch.device) -> Vec3:
        colours = [texture.texels().reshape(3) for texture in textures]
        return Vec3.of(torch.stack(colours).to(dtype=dtype, device=device))

    def read(self, bank: Vec3, row: Tensor, point: TexturePoint) -> Vec3:
        return lookup(bank, row)

    def rise(self, bank: Vec3, row: Tensor, point: TexturePoint) -> Vec2:
        none = torch.zeros_like(lookup(bank.x, row))
        return Vec2(none, none)


class Colour(Texture):
    """Base class of textures of one constant colour."""

    def colour(self) -> Tensor:
        """The colour as (3,) linear RGB, or () for grey; attached."""
        raise TypeError(f"{type(self).__name__} does not define its colour")

    def reader(self) -> ColourReader:
        """The object that looks constant colours up for lanes."""
        return ColourReader()

    def texels(self) -> Tensor:
        """The colour as texels, (1, 1, 3) linear RGB, attached."""
        return self.colour().expand(3).reshape(1, 1, 3)

    def scalars(self) -> Tensor:
        """The colour as a scalar, (1, 1): the mean of the channels, as in Mitsuba; attached."""
        return self.colour().mean().reshape(1, 1)
