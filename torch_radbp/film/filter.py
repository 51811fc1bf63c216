"""The base of reconstruction filters.

Filters are importance-sampled: the offset of a sample from its pixel's centre is drawn from the filter itself, so that a
pixel is the unweighted mean of its samples (Ernst et al. 2006, "Filter Importance Sampling").
"""

from __future__ import annotations

import torch
from torch import Tensor

from torch_radbp.plugin import ReconstructionFilter

TABLE_SIZE = 4097  # linear interpolation widens the tails: the variance of a Gaussian grows by 0.1%


class Filter(ReconstructionFilter):
    """A separable, non-negative filter."""

    radius: float

    def evaluate(self, x: Tensor) -> Tensor:
        """The filter at distances `x` from the centre, in pixels, not normalised."""
        raise TypeError(f"{type(self).__name__} does not define its values")

    def quantiles(self) -> Tensor:
        """Offsets in pixels at equally spaced values of the cumulative distribution: (TABLE_SIZE,) float64, on the CPU."""
        x = torch.linspace(-self.radius, self.radius, 4 * TABLE_SIZE + 1, dtype=torch.float64, device="cpu")
        middle = 0.5 * (x[1:] + x[:-1])
        cumulative = torch.cat([x.new_zeros(1), self.evaluate(middle).cumsum(0)])
        wanted = torch.linspace(0, 1, TABLE_SIZE, dtype=torch.float64, device="cpu") * cumulative[-1]
        right = torch.searchsorted(cumulative, wanted).clamp(1, len(x) - 1)
        low, high = cumulative[right - 1], cumulative[right]
        fraction = (wanted - low) / torch.where(high > low, high - low, 1.0)
        return x[right - 1] + fraction * (x[right] - x[right - 1])

    def inside(self, size: int) -> tuple[Tensor, Tensor]:
        """The part of the distribution inside a window, for each of the window's `size` columns (or rows) of pixels.

        Returns:
            The cumulative probability at the window's near edge, and the probability between its edges; (size,) float64
            each, on the CPU.
        """
        table = self.quantiles()
        centre = torch.arange(size, dtype=torch.float64, device="cpu") + 0.5

        def cumulative(offset: Tensor) -> Tensor:
            right = torch.searchsorted(table, offset).clamp(1, TABLE_SIZE - 1)
            step = table[right] - table[right - 1]
            fraction = (offset - table[right - 1]) / torch.where(step > 0, step, 1.0)
            return ((right - 1 + fraction) / (TABLE_SIZE - 1)).clamp(0, 1)

        first = cumulative(-centre)
        return first, cumulative(size - centre) - first
