"""The phase function of Henyey and Greenstein."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.interface.phase import CosineKind, PhaseFunction, entry
from torch_radbp.plugin import finite, register
from torch_radbp.plugin.domain import NUMBER, Domain

NEARLY_EVEN = 1e-3  # a mean cosine below which cosines are sampled evenly, and so off by less than rounding shows


class HenyeyGreensteinTable(NamedTuple):
    """The parameter of a Henyey-Greenstein phase function, one row; attached."""

    g: Tensor  # mean cosine


@dataclass(frozen=True)
class HenyeyGreensteinKind(CosineKind):
    """The Henyey-Greenstein phase function, (1 - g^2) / (4 pi (1 + g^2 - 2 g cos)^1.5)."""

    def of_cosine(self, table: HenyeyGreensteinTable, cosine: Tensor) -> tuple[Tensor, Tensor]:
        g = entry(table.g, cosine)
        base = 1.0 + g * g - 2.0 * g * cosine
        value = (1.0 - g * g) / (4.0 * math.pi * base * torch.sqrt(base))
        return value, value

    def sample_cosine(self, table: HenyeyGreensteinTable, u: Tensor) -> Tensor:
        # The inverse of the cumulative distribution; near g = 0 by its first two terms.
        g = entry(table.g, u)
        by, x = torch.where(g.abs() < NEARLY_EVEN, 1.0, g), 2.0 * u - 1.0
        ratio = (1.0 - by * by) / (1.0 + by * x)
        exact = (1.0 + by * by - ratio * ratio) / (2.0 * by)
        return torch.where(g.abs() < NEARLY_EVEN, x + 1.5 * g * (1.0 - x * x), exact).clamp(-1.0, 1.0)


@register("phase", "hg")
class HenyeyGreenstein(PhaseFunction):
    """Scatters mostly forwards, or backwards.

    Parameters: `g`. Derivatives: with respect to it. Reference: Henyey and Greenstein 1941, "Diffuse Radiation in the
    Galaxy".

    Args:
        g: the mean cosine of the angle by which light turns, less than 1 in magnitude; positive: forwards.
    """

    def __init__(self, *, g: float = 0.8):
        super().__init__()
        self.freeze("g", finite("g", g, ()).to(torch.get_default_dtype()))

    def domains(self) -> dict[str, Domain]:
        return {"g": NUMBER._replace(low=-1.0, high=1.0, low_is_in=False, high_is_in=False)}

    def kind(self) -> HenyeyGreensteinKind:
        return HenyeyGreensteinKind()

    def row(self) -> HenyeyGreensteinTable:
        return HenyeyGreensteinTable(self.g)
