"""The base of reconstruction filters.

Filters are importance-sampled: the offset of a sample from its pixel's centre is drawn from the filter's magnitude, so that
a pixel is the mean of its samples (Ernst et al. 2006, "Filter Importance Sampling"). Where the filter is negative, samples
count with a negative sign, and all the more, so that the mean weight is 1.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.plugin import ReconstructionFilter

TABLE_SIZE = 4097  # linear interpolation widens the tails: the variance of a Gaussian grows by 0.1%


class FilterPart(NamedTuple):
    """What the columns (or rows) of pixels of a window sample of a filter; (size,) each."""

    start: Tensor  # the cumulative magnitude at which the part begins
    length: Tensor  # the share of the magnitude in it
    weight: Tensor | None  # of a sample where the filter is positive, so that the mean is 1; None: 1


class FilterTable(NamedTuple):
    """A filter as it is sampled; float64, on the CPU."""

    quantiles: Tensor  # (TABLE_SIZE,) offsets in pixels at equally spaced values of the cumulative magnitude
    signs: Tensor | None  # (TABLE_SIZE - 1,) between them, integral of the filter over that of its magnitude; None: all 1

    def at(self, offset: Tensor) -> Tensor:
        """The cumulative magnitude at offsets in pixels, in [0, 1]."""
        right = torch.searchsorted(self.quantiles, offset).clamp(1, TABLE_SIZE - 1)
        step = self.quantiles[right] - self.quantiles[right - 1]
        fraction = (offset - self.quantiles[right - 1]) / torch.where(step > 0, step, 1.0)
        return ((right - 1 + fraction) / (TABLE_SIZE - 1)).clamp(0, 1)

    def density(self, offset: Tensor) -> Tensor:
        """The filter at offsets in pixels, such that the integral of its magnitude is 1; with its sign."""
        right = torch.searchsorted(self.quantiles, offset).clamp(1, TABLE_SIZE - 1)
        step = self.quantiles[right] - self.quantiles[right - 1]
        inside = (offset >= self.quantiles[0]) & (offset < self.quantiles[-1]) & (step > 0)
        density = inside / (torch.where(step > 0, step, 1.0) * (TABLE_SIZE - 1))
        return density if self.signs is None else density * self.signs[right - 1]

    def signed(self, start: Tensor, length: Tensor) -> Tensor:
        """The integral of the filter between values of its cumulative magnitude."""
        if self.signs is None:
            return length
        cumulative = torch.cat([self.signs.new_zeros(1), self.signs.cumsum(0)]) / (TABLE_SIZE - 1)

        def until(u: Tensor) -> Tensor:
            position = u * (TABLE_SIZE - 1)
            left = position.long().clamp(0, TABLE_SIZE - 2)
            return torch.lerp(cumulative[left], cumulative[left + 1], position - left)

        return until(start + length) - until(start)

    def whole(self, size: int) -> FilterPart:
        """All of the filter, for each of `size` columns (or rows) of pixels."""
        one = torch.ones(size, dtype=torch.float64, device="cpu")
        return self.part(torch.zeros_like(one), one)

    def inside(self, size: int) -> FilterPart:
        """The part of the filter inside a window, for each of the window's `size` columns (or rows) of pixels."""
        centre = torch.arange(size, dtype=torch.float64, device="cpu") + 0.5
        start = self.at(-centre)
        return self.part(start, self.at(size - centre) - start)

    def part(self, start: Tensor, length: Tensor) -> FilterPart:
        """The part from `start` on with its weight."""
        weight = None if self.signs is None else length / self.signed(start, length)
        return FilterPart(start, length, weight)


class Filter(ReconstructionFilter):
    """A separable filter."""

    radius: float

    def evaluate(self, x: Tensor) -> Tensor:
        """The filter at distances `x` from the centre, in pixels, not normalised."""
        raise TypeError(f"{type(self).__name__} does not define its values")

    def table(self) -> FilterTable:
        """What is sampled.

        Raises:
            ValueError: if the integral of the filter is not greater than zero.
        """
        x = torch.linspace(-self.radius, self.radius, 4 * TABLE_SIZE + 1, dtype=torch.float64, device="cpu")
        values = self.evaluate(0.5 * (x[1:] + x[:-1]))
        cumulative = torch.cat([x.new_zeros(1), values.abs().cumsum(0)])
        wanted = torch.linspace(0, 1, TABLE_SIZE, dtype=torch.float64, device="cpu") * cumulative[-1]
        right = torch.searchsorted(cumulative, wanted).clamp(1, len(x) - 1)
        low, high = cumulative[right - 1], cumulative[right]
        fraction = (wanted - low) / torch.where(high > low, high - low, 1.0)
        quantiles = x[right - 1] + fraction * (x[right] - x[right - 1])
        if (values >= 0).all():
            return FilterTable(quantiles, None)
        if not values.sum() > 0:
            raise ValueError(f"the filter {self.type} must have an integral greater than 0; these parameters make it less")
        signed = torch.cat([x.new_zeros(1), values.cumsum(0)])
        signed = torch.lerp(signed[right - 1], signed[right], fraction)
        return FilterTable(quantiles, signed.diff() / cumulative[-1] * (TABLE_SIZE - 1))
