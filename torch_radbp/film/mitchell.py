"""The Mitchell-Netravali filter."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torch_radbp.film.filter import Filter, Kernel
from torch_radbp.plugin import register


@register("rfilter", "mitchell")
class Mitchell(Filter):
    """A piecewise cubic function with a radius of 2 pixels, which trades ringing against blurring by two parameters.

    Args:
        B: blurs. The default of 1/3 for both is the authors'.
        C: rings.

    Reference: Mitchell and Netravali 1988, "Reconstruction Filters in Computer Graphics", equation 8.
    """

    def __init__(self, *, B: float = 1 / 3, C: float = 1 / 3):
        super().__init__()
        self.B, self.C, self.radius = float(B), float(C), 2.0
        if not (math.isfinite(self.B) and math.isfinite(self.C)):
            raise ValueError(f"B and C must be finite, got {B} and {C}")

    def kernel(self) -> Kernel:
        return Kernel(cubic, (self.B, self.C), self.radius)


def cubic(x: Tensor, b: float, c: float) -> Tensor:
    """The family of piecewise cubic filters of Mitchell and Netravali; 0 beyond 2."""
    x = x.abs()
    near = (12 - 9 * b - 6 * c) * x**3 + (-18 + 12 * b + 6 * c) * x**2 + (6 - 2 * b)
    far = (-b - 6 * c) * x**3 + (6 * b + 30 * c) * x**2 + (-12 * b - 48 * c) * x + (8 * b + 24 * c)
    return torch.where(x < 1, near, torch.where(x < 2, far, 0.0)) / 6
