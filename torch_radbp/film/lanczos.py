"""The windowed sinc filter."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_radbp.film.filter import Filter
from torch_radbp.plugin import integer, register


@register("rfilter", "lanczos")
class Lanczos(Filter):
    """The sinc function, windowed by the main lobe of a wider one: sharp, and rings the most.

    Args:
        lobes: its radius in pixels.
    """

    def __init__(self, *, lobes: int = 3):
        super().__init__()
        self.lobes = integer("lobes", lobes, 1)
        self.radius = float(self.lobes)

    def evaluate(self, x: Tensor) -> Tensor:
        return torch.where(x.abs() < self.radius, torch.sinc(x) * torch.sinc(x / self.lobes), 0.0)
