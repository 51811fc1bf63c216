"""The Gaussian filter."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torch_radbp.film.filter import Filter, Kernel
from torch_radbp.plugin import positive, register

CUT = 4.0  # standard deviations


@register("rfilter", "gaussian")
class Gaussian(Filter):
    """A Gaussian of standard deviation `stddev` pixels, cut at 4 `stddev` and lowered to reach zero there, as Mitsuba's."""

    def __init__(self, *, stddev: float = 0.5):
        super().__init__()
        self.stddev = positive("stddev", stddev)
        self.radius = CUT * self.stddev

    def kernel(self) -> Kernel:
        return Kernel(gaussian, (self.stddev,), self.radius)


def gaussian(x: Tensor, stddev: float) -> Tensor:
    """A Gaussian that has been lowered."""
    return (torch.exp(-(x * x) * (0.5 / stddev**2)) - math.exp(-0.5 * CUT**2)).clamp_min(0.0)
