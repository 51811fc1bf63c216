"""The windowed sinc (Lanczos) filter."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torch_radbp.film.filter import Filter, Kernel
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

    def kernel(self) -> Kernel:
        return Kernel(windowed_sinc, (self.radius,), self.radius)


def windowed_sinc(x: Tensor, lobes: float) -> Tensor:
    """The sinc function times a sinc that is `lobes` times as wide."""
    return torch.where(x.abs() < lobes, sinc(x) * sinc(x / lobes), 0.0)


def sinc(x: Tensor) -> Tensor:
    """The normalised sinc function sin(pi x) / (pi x)."""
    angle = math.pi * x
    return torch.where(x == 0, 1.0, torch.sin(angle) / torch.where(x == 0, 1.0, angle))
