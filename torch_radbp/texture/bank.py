"""Images concatenated to one table of texels, and their look-up at surface coordinates."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.vec import Vec2, Vec3
from torch_radbp.texture.uv_transform import transformed


class TextureBank(NamedTuple):
    """Textures in one table of texels; a constant colour is a texture of one texel. X textures, K texels in all."""

    texels: Vec3  # (K,) each, linear RGB; attached
    offset: Tensor  # (X,) int32, first texel
    width: Tensor  # (X,) int32
    height: Tensor  # (X,) int32
    wrap: Tensor  # (X,) int32: 0 repeat, 1 mirror, 2 clamp
    nearest: Tensor  # (X,) bool
    to_u: Vec3  # (X,) rows of the transforms: u' = x u + y v + z
    to_v: Vec3


def wrapped(texel: Tensor, size: Tensor, wrap: Tensor) -> tuple[Tensor, Tensor]:
    """Integer texel coordinates, and those of the next texels, wrapped to [0, size) by each lane's wrap mode."""
    mirrors, clamps = wrap == 1, wrap == 2
    period = torch.where(mirrors, 2 * size, size)
    first = torch.remainder(texel, period)  # one division for all
    after = torch.where(first + 1 == period, 0, first + 1)

    def inside(folded: Tensor, texel: Tensor) -> Tensor:
        repeat_or_mirror = torch.where(mirrors, torch.minimum(folded, 2 * size - 1 - folded), folded)
        return torch.where(clamps, torch.minimum(texel.clamp_min(0), size - 1), repeat_or_mirror)

    return inside(first, texel), inside(after, texel + 1)


class Texels(NamedTuple):
    """The four texels around a point, (N,) each, and the point's position between them."""

    rows: tuple[Tensor, Tensor, Tensor, Tensor]  # rows of the bank: upper left, upper right, lower left, lower right
    fx: Tensor  # in [0, 1), attached; 0 with nearest filtering
    fy: Tensor
    width: Tensor  # of the texture
    height: Tensor
    nearest: Tensor  # bool


def _texels_around(bank: TextureBank, texture: Tensor, first: Tensor, uv: Vec2) -> Texels:
    """The four texels around surface coordinates.

    Args:
        bank, texture: as for `sample_texture`.
        first: (N,) int32, first texel of the texture.
        uv: (N,) after the transform of the texture.
    """
    width, height, wrap = lookup(bank.width, texture), lookup(bank.height, texture), lookup(bank.wrap, texture)
    nearest = lookup(bank.nearest, texture)
    half = torch.where(nearest, 0.0, 0.5).to(uv.x.dtype)
    x, y = uv.x * width - half, uv.y * height - half
    left, top = torch.floor(x.detach()), torch.floor(y.detach())
    fx = torch.where(half > 0, x - left, 0.0)
    fy = torch.where(half > 0, y - top, 0.0)
    column, row = left.to(torch.int32), top.to(torch.int32)
    x0, x1 = wrapped(column, width, wrap)
    y0, y1 = (row * width + first for row in wrapped(row, height, wrap))
    return Texels((y0 + x0, y0 + x1, y1 + x0, y1 + x1), fx, fy, width, height, nearest)


def sample_texture(bank: TextureBank, texture: Tensor, uv: Vec2 | None) -> Vec3:
    """Looks textures up at surface coordinates; linear RGB.

    Args:
        bank: attached or tapped.
        texture: (N,) int32, which texture each lane reads.
        uv: (N,) surface coordinates, or None if every texture of the bank is one texel.
    """
    first = lookup(bank.offset, texture)
    if uv is None:
        return lookup(bank.texels, first)
    at = _texels_around(bank, texture, first, transformed(lookup(bank.to_u, texture), lookup(bank.to_v, texture), uv))
    upper_left, upper_right, lower_left, lower_right = (lookup(bank.texels, row) for row in at.rows)
    upper = upper_left * (1.0 - at.fx) + upper_right * at.fx
    lower = lower_left * (1.0 - at.fx) + lower_right * at.fx
    return upper * (1.0 - at.fy) + lower * at.fy


def texture_slope(bank: TextureBank, texture: Tensor, uv: Vec2) -> Vec2:
    """The derivatives of textures' first channel by u and by v, before their transform: those of bilinear interpolation,
    which jump at the centres of texels; zero with nearest filtering. Attached.

    Args: as for `sample_texture`.
    """
    to_u, to_v = lookup(bank.to_u, texture), lookup(bank.to_v, texture)
    at = _texels_around(bank, texture, lookup(bank.offset, texture), transformed(to_u, to_v, uv))
    upper_left, upper_right, lower_left, lower_right = (lookup(bank.texels.x, row) for row in at.rows)
    smooth = (~at.nearest).to(uv.x.dtype)
    by_x = ((upper_right - upper_left) * (1.0 - at.fy) + (lower_right - lower_left) * at.fy) * (at.width * smooth)
    by_y = ((lower_left - upper_left) * (1.0 - at.fx) + (lower_right - upper_right) * at.fx) * (at.height * smooth)
    return Vec2(by_x * to_u.x + by_y * to_v.x, by_x * to_u.y + by_y * to_v.y)
