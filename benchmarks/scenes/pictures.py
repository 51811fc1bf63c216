"""Pictures from formulas for the scenes, written as files that both renderers load."""

from __future__ import annotations

import math
from pathlib import Path

import torch
from torch import Tensor

import torch_radbp as rb


def grid(height: int, width: int) -> tuple[Tensor, Tensor]:
    """(H, W) coordinates (u, v) in (0, 1) of the centres of pixels; v grows downwards."""
    v, u = torch.meshgrid((torch.arange(height) + 0.5) / height, (torch.arange(width) + 0.5) / width, indexing="ij")
    return u, v


def pattern(size: int, number: int) -> Tensor:
    """(size, size) values in [0, 1]: one of a family of tileable patterns of tiles, waves and grain."""
    u, v = grid(size, size)
    generator = torch.Generator().manual_seed(number)
    tiles = 2 + number % 4
    shade = torch.rand(tiles, tiles, generator=generator)[(tiles * v).long(), (tiles * u).long()]
    waves = 0.5 + 0.5 * torch.sin(2 * math.pi * (number % 3 * u + (1 + number % 5) * v) + torch.sin(4 * math.pi * u))
    grain = torch.rand(size, size, generator=generator)
    joint = ((tiles * u) % 1 < 0.06) | ((tiles * v) % 1 < 0.06)
    return torch.where(joint, 0.05, 0.5 * shade + 0.35 * waves + 0.15 * grain)


def coloured(values: Tensor, dark: tuple[float, float, float], light: tuple[float, float, float]) -> Tensor:
    """(3, H, W) linear RGB: values (H, W) of 0 become `dark`, of 1 `light`."""
    dark, light = (torch.tensor(colour)[:, None, None] for colour in (dark, light))
    return dark + (light - dark) * values


def sky(height: int, width: int) -> Tensor:
    """(3, H, W) radiance by latitude and longitude, +y at the top: a blue gradient over dim ground, and a sun."""
    u, v = grid(height, width)
    above = (1 - 2 * v).clamp_min(0.0)
    blue = coloured(above.sqrt(), (0.9, 0.85, 0.8), (0.15, 0.3, 0.75))
    image = torch.where(v < 0.5, blue, torch.tensor([0.12, 0.1, 0.08])[:, None, None])
    distance = torch.hypot((u - 0.63) * 2 * math.pi * math.sin(0.27 * math.pi), (v - 0.27) * math.pi)
    sun = torch.exp(-((distance / 0.06) ** 2))
    return image + sun * torch.tensor([60.0, 52.0, 40.0])[:, None, None]


def written(folder: Path, name: str, picture: Tensor) -> str:
    """Writes a (3, H, W) linear picture as `name`.exr, and returns the absolute name of the file.

    Mitsuba keeps the texels of a PNG as bytes, which have no derivative.
    """
    path = folder.resolve() / f"{name}.exr"
    rb.save_image(path, picture)
    return str(path)
