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
    """A Gaussian of standard deviation `stddev` pixels, cut at 4 `stddev` and lowered to reach zero there, as Mitsuba's.

    Args:
        stddev: the standard deviation, pixels.
    """

    def __init__(self, *, stddev: float = 0.5):
        super().__init__()
        self.stddev = positive("stddev", stddev)
        self.radius = CUT * self.stddev

    def kernel(self) -> Kernel:
        return Kernel(gaussian, (self.stddev,), self.radius, gaussians)


def gaussian(x: Tensor, stddev: float) -> Tensor:
    """The Gaussian, lowered to reach zero at its radius."""
    return (torch.exp(-(x * x) * (0.5 / stddev**2)) - math.exp(-0.5 * CUT**2)).clamp_min(0.0)


def gaussians(u: Tensor, reach: int, stddev: float) -> list[Tensor]:
    """The lowered Gaussian at distances t - d of points t = u - 1/2 from pixels d = -reach ... reach, by two exponentials:

        exp(-(t - d)^2 / 2 s^2) = exp(-t^2 / 2 s^2) exp(t / s^2)^d exp(-d^2 / 2 s^2)
    """
    t, half = u - 0.5, 0.5 / stddev**2
    step = torch.exp(t * (2.0 * half))
    back, steps = 1.0 / step, {0: torch.exp(-(t * t) * half)}
    for offset in range(1, reach + 1):
        steps[offset], steps[-offset] = steps[offset - 1] * step, steps[1 - offset] * back
    return [(steps[offset] * math.exp(-offset**2 * half) - math.exp(-0.5 * CUT**2)).clamp_min(0.0)
            for offset in range(-reach, reach + 1)]
