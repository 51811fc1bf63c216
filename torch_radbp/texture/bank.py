"""Images laid end to end, and the reading of them at surface coordinates."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.lookup import lookup
from torch_radbp.texture.uv_transform import transformed
from torch_radbp.vec import Vec2, Vec3


class TextureBank(NamedTuple):
    """Textures laid end to end; a constant colour is a texture of one texel. X textures, K texels in all."""

    texels: Vec3  # (K,) each, linear RGB; attached
    offset: Tensor  # (X,) int32, first texel
    width: Tensor  # (X,) int32
    height: Tensor  # (X,) int32
    wrap: Tensor  # (X,) int32: 0 repeat, 1 mirror, 2 clamp
    nearest: Tensor  # (X,) bool
    to_u: Vec3  # (X,) each: u' = x u + y v + z
    to_v: Vec3


def wrapped(texel: Tensor, size: Tensor, wrap: Tensor) -> tuple[Tensor, Tensor]:
    """Integer texel coordinates, and those of the next texels, brought into [0, size) by each lane's wrap mode."""
    mirrors, clamps = wrap == 1, wrap == 2
    period = torch.where(mirrors, 2 * size, size)
    first = torch.remainder(texel, period)  # one division for all
    after = torch.where(first + 1 == period, 0, first + 1)

    def inside(folded: Tensor, texel: Tensor) -> Tensor:
        repeat_or_mirror = torch.where(mirrors, torch.minimum(folded, 2 * size - 1 - folded), folded)
        return torch.where(clamps, torch.minimum(texel.clamp_min(0), size - 1), repeat_or_mirror)

    return inside(first, texel), inside(after, texel + 1)


def sample_texture(bank: TextureBank, texture: Tensor, uv: Vec2 | None) -> Vec3:
    """Linear RGB of textures at surface coordinates.

    Args:
        bank: attached or tapped.
        texture: (N,) int32, which texture each lane reads.
        uv: (N,) surface coordinates, or None if every texture of the bank is one texel.
    """
    first = lookup(bank.offset, texture)
    if uv is None:
        return lookup(bank.texels, first)
    width, height, wrap = lookup(bank.width, texture), lookup(bank.height, texture), lookup(bank.wrap, texture)
    to_u, to_v = lookup(bank.to_u, texture), lookup(bank.to_v, texture)
    half = torch.where(lookup(bank.nearest, texture), 0.0, 0.5).to(uv.x.dtype)
    uv = transformed(to_u, to_v, uv)
    x, y = uv.x * width - half, uv.y * height - half
    left, top = torch.floor(x.detach()), torch.floor(y.detach())
    fx = torch.where(half > 0, x - left, 0.0)
    fy = torch.where(half > 0, y - top, 0.0)
    column, row = left.to(torch.int32), top.to(torch.int32)
    x0, x1 = wrapped(column, width, wrap)
    y0, y1 = (row * width + first for row in wrapped(row, height, wrap))
    upper = lookup(bank.texels, y0 + x0) * (1.0 - fx) + lookup(bank.texels, y0 + x1) * fx
    lower = lookup(bank.texels, y1 + x0) * (1.0 - fx) + lookup(bank.texels, y1 + x1) * fx
    return upper * (1.0 - fy) + lower * fy
