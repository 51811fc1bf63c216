"""The Gaussian filter."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torch_radbp.film.filter import Filter
from torch_radbp.plugin import positive, register


@register("rfilter", "gaussian")
class Gaussian(Filter):
    """A Gaussian of standard deviation `stddev` pixels, cut at 4 `stddev` and lowered to reach zero there, as Mitsuba's."""

    def __init__(self, *, stddev: float = 0.5):
        super().__init__()
        self.stddev = positive("stddev", stddev)
        self.radius = 4 * self.stddev

    def evaluate(self, x: Tensor) -> Tensor:
        edge = math.exp(-(self.radius**2) / (2 * self.stddev**2))
        return (torch.exp(-(x**2) / (2 * self.stddev**2)) - edge).clamp_min(0.0)
