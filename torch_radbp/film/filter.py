"""The base class of reconstruction filters.

A sample counts in every pixel around it by the filter at its distance from the pixel's centre. A pixel is the sum of what
the samples around it count there, divided by the sum of the filter's values.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from torch_radbp.film.window import Span
from torch_radbp.plugin import ReconstructionFilter

STEPS = 1024  # for each pixel of width, by which integrals of filters are found


@dataclass(frozen=True)
class Kernel:
    """A reconstruction filter as a hashable value, for functions of lanes."""

    function: Callable[..., Tensor]  # of distances from the centre, and of `numbers`; 0 beyond the radius
    numbers: tuple[float, ...]
    radius: float  # pixels
    side_by_side: Callable[..., list[Tensor]] | None = None  # see `around`; of positions in a pixel, the reach and `numbers`

    @property
    def reach(self) -> int:
        """The greatest offset, in pixels, from a sample's pixel to one in which it counts."""
        return math.ceil(self.radius - 0.5)

    def __call__(self, x: Tensor) -> Tensor:
        """The filter at distances `x` from the centre, in pixels, not normalised."""
        return self.function(x, *self.numbers)

    def around(self, u: Tensor) -> list[Tensor]:
        """The filter weights of samples in the pixels around them, from offset -`reach` to `reach`.

        Args:
            u: (N,) where in its pixel each lies, in [0, 1).
        """
        if self.side_by_side is not None:
            return self.side_by_side(u, self.reach, *self.numbers)
        return [self(u - (0.5 + offset)) for offset in range(-self.reach, self.reach + 1)]

    def nearby(self, u: Tensor) -> tuple[Tensor | int, list[Tensor]]:
        """The filter weights of samples in the pixels around, as by `around`, without an outermost pixel where they are 0.

        Returns:
            The offset of the first pixel, (N,) int32 or one for all, and the weights.
        """
        values = self.around(u)
        if math.ceil(2 * self.radius) == len(values):
            return -self.reach, values
        beyond = u > self.radius + 0.5 - self.reach  # the first is too far away, else the last
        return beyond.to(torch.int32) - self.reach, [torch.where(beyond, *pair) for pair in zip(values[1:], values)]

    @property
    def flat(self) -> bool:
        """True if all samples have equal weights, each in its own pixel alone."""
        return self.reach == 0 and self.radius == 0.5 and self.function is constant

    def inside(self, span: Span) -> Tensor:
        """(span.size,) float64, on the CPU: each column's (or row's) integral of the filter over where samples lie."""
        of_pixels = self.of_pixels()
        sampled = torch.ones(span.sampled, dtype=torch.float64, device="cpu")
        return torch.nn.functional.conv1d(sampled[None, None], of_pixels[None, None], padding=self.reach)[0, 0][
            span.before:span.before + span.size]

    def of_pixels(self) -> Tensor:
        """(2 reach + 1,) float64, on the CPU: the filter's integrals over the pixels around one."""
        edges = torch.linspace(0, 2 * self.reach + 1, (2 * self.reach + 1) * STEPS + 1, dtype=torch.float64, device="cpu")
        x = 0.5 * (edges[1:] + edges[:-1]) - (self.reach + 0.5)
        return self(x).view(-1, STEPS).mean(1)

    @property
    def integral(self) -> float:
        """The filter's integral along one axis, pixels."""
        return float(self.of_pixels().sum())


def constant(x: Tensor, radius: float) -> Tensor:
    """The box filter: 1 up to the radius."""
    return (x.abs() <= radius).to(x.dtype)


class Filter(ReconstructionFilter):
    """Base class of separable reconstruction filters."""

    radius: float  # where it ends, pixels from the centre

    def kernel(self) -> Kernel:
        """The filter as a `Kernel`, a hashable value for functions of lanes."""
        raise TypeError(f"{type(self).__name__} does not define its values")

    def evaluate(self, x: Tensor) -> Tensor:
        """The filter at distances `x` from the centre, in pixels, not normalised."""
        return self.kernel()(x)
