"""A checkerboard of two textures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torch_radbp.interface.texture import TableReader, TexturePoint
from torch_radbp.plugin import Matrix4, Texture, register
from torch_radbp.plugin.domain import Domain
from torch_radbp.plugin.jump_lines import JumpLines
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.vec import Vec2, Vec3
from torch_radbp.texture.mixed import reader_for
from torch_radbp.texture.rgb import as_texture
from torch_radbp.texture.uv_transform import jump_lines, transformed, uv_matrix, uv_rows


class CheckerboardBank(NamedTuple):
    """The table of X checkerboards: their transforms, and the table of their colours."""

    to_u: Vec3  # (X,) rows of the transforms: u' = x u + y v + z
    to_v: Vec3
    colours: Any  # the bank of their 2 X colours, those of each checkerboard side by side


@dataclass(frozen=True)
class CheckerboardReader(TableReader):
    """Looks checkerboards up, for lanes; `colours` looks up those of the squares. Bank: `CheckerboardBank`."""

    colours: TableReader

    def bank(self, textures: Sequence[Texture], dtype: torch.dtype, device: torch.device) -> CheckerboardBank:
        colours = [colour for texture in textures for colour in texture.colours()]
        return CheckerboardBank(*uv_rows([texture.to_uv for texture in textures], dtype, device),
                                self.colours.bank(colours, dtype, device))

    @property
    def needs_footprint(self) -> bool:
        return self.colours.needs_footprint

    @property
    def needs_position(self) -> bool:
        return self.colours.needs_position

    @property
    def attributes(self) -> tuple[str, ...]:
        return self.colours.attributes

    def of_numbers(self) -> CheckerboardReader:
        return CheckerboardReader(self.colours.of_numbers())

    def read(self, bank: CheckerboardBank, row: Tensor, point: TexturePoint) -> Vec3:
        return self.colours.read(bank.colours, self.row_of_colour(bank, row, point), point)

    def rise(self, bank: CheckerboardBank, row: Tensor, point: TexturePoint) -> Vec2:
        return self.colours.rise(bank.colours, self.row_of_colour(bank, row, point), point)

    def row_of_colour(self, bank: CheckerboardBank, row: Tensor, point: TexturePoint) -> Tensor:
        """The row, in the table of colours, of the square that each lane is in."""
        u, v = transformed(lookup(bank.to_u, row), lookup(bank.to_v, row), point.uv)
        right, lower = u - torch.floor(u) > 0.5, v - torch.floor(v) > 0.5
        return 2 * row + (right != lower).to(row.dtype)


@register("texture", "checkerboard")
class Checkerboard(Texture):
    """Two textures in turn: squares of half a unit of the surface coordinates, `color0` in the one that begins at 0, 0.

    Where Mitsuba 3.9.1 asks a checkerboard for a number, such as a roughness, it exchanges the two, as is done here.

    Parameters: those of the colours. Derivatives: with respect to these. `to_uv` moves nothing but edges, and is no
    parameter.

    Args:
        color0, color1: any textures but modules; grey 0.4 and 0.2 by default.
        to_uv: transform of the surface coordinates by which a place chooses between the two (its 2D affine part).
    """

    numbers = ("color1", "color0")  # the colours in turn where numbers are asked for

    def __init__(self, *, color0: Texture | float = 0.4, color1: Texture | float = 0.2, to_uv: Matrix4 | None = None):
        super().__init__()
        self.color0, self.color1 = as_texture(self, "color0", color0), as_texture(self, "color1", color1)
        self.register_buffer("to_uv", uv_matrix(to_uv))

    def domains(self) -> dict[str, Domain]:
        return {"color0": Domain(), "color1": Domain()}

    def colours(self) -> tuple[Texture, ...]:
        """The two textures of the squares."""
        return self.color0, self.color1

    def parts(self) -> tuple[Texture, ...]:
        return self.colours()

    def jumps(self) -> tuple[JumpLines, ...]:
        return *jump_lines(self.to_uv, (2, 2)), *super().jumps()

    def resolution(self) -> tuple[int, int]:
        return 1, 1

    def reader(self) -> CheckerboardReader:
        """The object that looks checkerboards up for lanes."""
        return CheckerboardReader(reader_for(self.colours()))
