"""Scattering into all directions alike."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from torch_radbp.interface.phase import CosineKind, PhaseFunction
from torch_radbp.plugin import register


@dataclass(frozen=True)
class IsotropicKind(CosineKind):
    """The isotropic phase function, 1 / (4 pi)."""

    def of_cosine(self, table: tuple[()], cosine: Tensor) -> tuple[Tensor, Tensor]:
        even = torch.full_like(cosine, 0.25 / math.pi)
        return even, even

    def sample_cosine(self, table: tuple[()], u: Tensor) -> Tensor:
        return 1.0 - 2.0 * u


@register("phase", "isotropic")
class Isotropic(PhaseFunction):
    """Scatters into all directions alike."""

    def __init__(self) -> None:
        super().__init__()

    def kind(self) -> IsotropicKind:
        return IsotropicKind()
