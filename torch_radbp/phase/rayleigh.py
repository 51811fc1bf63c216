"""Scattering by what is much smaller than the wavelength, as of light by air."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from torch_radbp.interface.phase import CosineKind, PhaseFunction
from torch_radbp.plugin import register


@dataclass(frozen=True)
class RayleighKind(CosineKind):
    """Rayleigh's phase function, 3 / (16 pi) (1 + cos^2)."""

    def of_cosine(self, table: tuple[()], cosine: Tensor) -> tuple[Tensor, Tensor]:
        value = (1.0 + cosine * cosine) * (3.0 / (16.0 * math.pi))
        return value, value

    def sample_cosine(self, table: tuple[()], u: Tensor) -> Tensor:
        # The root of x^3 + 3 x = 8 u - 4, by Cardano; the cubes of its two parts have the product -1.
        half = 4.0 * u - 2.0
        cube = half.abs() + torch.sqrt(half * half + 1.0)
        part = torch.exp(torch.log(cube) / 3.0)
        return torch.copysign(part - 1.0 / part, half).clamp(-1.0, 1.0)


@register("phase", "rayleigh")
class Rayleigh(PhaseFunction):
    """Scatters as air does, as much forwards as backwards. Reference: Rayleigh 1871, "On the light from the sky"."""

    def __init__(self) -> None:
        super().__init__()

    def kind(self) -> RayleighKind:
        return RayleighKind()
