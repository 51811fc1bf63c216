"""Mipmaps: images at halved resolutions, looked up at the level that fits the footprint of a sample.

Each level is the mean of the one below over boxes, down to one texel, so that all levels have the same mean. A side of odd
length 2 m + 1 becomes m texels, each of which covers 2 + 1 / m texels of the finer level: the weights of the three that it
touches are the areas covered (Guthe and Heckbert 2005, "Non-Power-of-Two Mipmapping"). No box crosses the border of the
image, so that the levels are the same for every wrap mode; that decides which texels of a level lie beside each other.

The level is

    log2(width of what is seen, in texels of the finest level)

between that and the coarsest; values are interpolated linearly between two levels (Williams 1983, "Pyramidal
Parametrics"). It is attached: an image changes as what is seen of a surface grows.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.vec import TINY, Vec2, Vec3
from torch_radbp.texture.bank import TextureBank, sample_texture, texture_slope

TO_BINARY = 1.0 / math.log(2.0)


class PyramidBank(NamedTuple):
    """X images, each followed by its coarser mipmap levels."""

    levels: TextureBank  # all levels of all images as textures
    first: Tensor  # (X,) int32, index of the finest level of each
    count: Tensor  # (X,) int32, number of levels of each


class Blend(NamedTuple):
    """The two mipmap levels that each lane reads, and the weight of the coarser one."""

    finer: Tensor  # (N,) int32, rows of `PyramidBank.levels`
    coarser: Tensor
    share: Tensor  # (N,) in [0, 1], attached


def half_size(image: Tensor, axis: int) -> Tensor:
    """Halves an image along an axis, rounded down, by averaging over the area that each texel covers; attached."""
    size = image.shape[axis]
    if size == 1:
        return image
    half = size // 2
    first, second = (image.narrow(axis, start, size - start).unfold(axis, 1, 2).squeeze(-1).narrow(axis, 0, half)
                     for start in (0, 1))
    if size % 2 == 0:
        return (first + second) * 0.5
    third = image.narrow(axis, 2, size - 2).unfold(axis, 1, 2).squeeze(-1)
    number = torch.arange(half, dtype=image.dtype, device=image.device)
    number = number.view([half if place == axis else 1 for place in range(image.ndim)])
    return (first * (half - number) + second * half + third * (number + 1)) / size


def pyramid(image: Tensor) -> list[Tensor]:
    """The mipmap levels of an image, (H, W, C), down to one texel; attached."""
    levels = [image]
    while max(levels[-1].shape[:2]) > 1:
        levels.append(half_size(half_size(levels[-1], 0), 1))
    return levels


def starts(counts: Sequence[int]) -> list[int]:
    """The offsets of consecutive runs of the given lengths."""
    return [0, *itertools.accumulate(counts)][:-1]


def levels_for(bank: PyramidBank, texture: Tensor, footprint: Tensor) -> Blend:
    """The mipmap levels that fit a footprint.

    Args:
        bank: attached or tapped.
        texture: (N,) int32, which image each lane reads.
        footprint: (N,) natural logarithm of the width in surface coordinates of what is seen, attached.
    """
    first, last = lookup(bank.first, texture), lookup(bank.count, texture) - 1
    levels = bank.levels
    to_u, to_v = lookup(levels.to_u, first), lookup(levels.to_v, first)
    area = (to_u.x * to_v.y - to_u.y * to_v.x).abs() * (lookup(levels.width, first) * lookup(levels.height, first))
    level = (footprint + 0.5 * torch.log(area.clamp_min(TINY))) * TO_BINARY
    level = torch.minimum(level.clamp_min(0.0), last.to(level.dtype))
    below = torch.floor(level.detach()).to(torch.int32)
    return Blend(first + below, first + torch.minimum(below + 1, last), level - below)


def sample_pyramid(bank: PyramidBank, texture: Tensor, uv: Vec2, footprint: Tensor | None) -> Vec3:
    """Looks mipmapped images up, linear RGB, attached. Args as for `levels_for`; without a footprint at the finest level."""
    if footprint is None:
        return sample_texture(bank.levels, lookup(bank.first, texture), uv)
    at = levels_for(bank, texture, footprint)
    finer, coarser = (sample_texture(bank.levels, row, uv) for row in (at.finer, at.coarser))
    return finer * (1.0 - at.share) + coarser * at.share


def pyramid_slope(bank: PyramidBank, texture: Tensor, uv: Vec2, footprint: Tensor | None) -> Vec2:
    """The derivatives of the first channel by u and by v at a fixed mipmap level; see `texture_slope`."""
    if footprint is None:
        return texture_slope(bank.levels, lookup(bank.first, texture), uv)
    at = levels_for(bank, texture, footprint)
    finer, coarser = (texture_slope(bank.levels, row, uv) for row in (at.finer, at.coarser))
    return Vec2(*(one * (1.0 - at.share) + other * at.share for one, other in zip(finer, coarser)))
