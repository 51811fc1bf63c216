"""Parametrisations by unbounded numbers: logarithms of positive values, and sigmoids of a range."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from torch_radbp.plugin import positive


class Log(nn.Module):
    """A parametrisation x = exp(u) of positive values whose ratios matter, such as radiance.

        radiance = scene.lamp.emitter.radiance
        parametrize.register_parametrization(radiance, "value", rb.optim.Log())
        optimizer = torch.optim.Adam([radiance.parametrizations.value.original])  # u

    A step of 0.1 in u changes x by a tenth, however large it is.

    Args:
        least: values below become this one when they are registered or assigned, since no u gives 0; in units of x.

    Raises:
        ValueError: if it is not positive.
    """

    def __init__(self, least: float = 1e-6):
        super().__init__()
        self.least = positive("least", least)

    def forward(self, logarithm: Tensor) -> Tensor:
        """The value x = exp(u), of any shape; attached."""
        return logarithm.exp()

    def right_inverse(self, values: Tensor) -> Tensor:
        """u = log(x): the inverse of `forward`.

        Raises:
            ValueError: if a value is negative.
        """
        if bool((values < 0).any()):
            raise ValueError(f"values must not be negative to have a logarithm, got {float(values.min()):g}")
        return values.clamp_min(self.least).log()


class Sigmoid(nn.Module):
    """A parametrisation x = low + (high - low) / (1 + exp(-u)) of values in a range, such as reflectance and roughness.

    For `torch.nn.utils.parametrize.register_parametrization`, as `Log`. Steps become smaller towards both ends, which are
    never reached; nothing has to be clamped after a step.

    Args:
        low, high: of the range.
        margin: the share of the range that values keep from either end when they are registered or assigned, since at
            the ends themselves u would be infinite and its derivative 0.

    Raises:
        ValueError: unless low < high and 0 < margin < 0.5.
    """

    def __init__(self, low: float = 0.0, high: float = 1.0, margin: float = 1e-3):
        super().__init__()
        if not low < high:
            raise ValueError(f"low must be less than high, got {low} and {high}")
        if not 0 < margin < 0.5:
            raise ValueError(f"margin must be between 0 and 0.5, got {margin}")
        self.low, self.high, self.margin = float(low), float(high), float(margin)

    def forward(self, unbounded: Tensor) -> Tensor:
        """The value x in the range from u, of any shape; attached."""
        return self.low + (self.high - self.low) * unbounded.sigmoid()

    def right_inverse(self, values: Tensor) -> Tensor:
        """The u for a value x in the range: the inverse of `forward`.

        Raises:
            ValueError: if a value is outside of the range.
        """
        if bool(((values < self.low) | (values > self.high)).any()):
            raise ValueError(f"values must be from {self.low:g} to {self.high:g}, got {float(values.min()):g} to "
                             f"{float(values.max()):g}")
        return torch.logit(((values - self.low) / (self.high - self.low)).clamp(self.margin, 1 - self.margin))
