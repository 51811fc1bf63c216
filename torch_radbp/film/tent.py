"""The tent filter."""

from __future__ import annotations

from torch import Tensor

from torch_radbp.film.filter import Filter, Kernel
from torch_radbp.plugin import positive, register


@register("rfilter", "tent")
class Tent(Filter):
    """A filter that falls linearly to zero at `radius` pixels.

    Args:
        radius: pixels.
    """

    def __init__(self, *, radius: float = 1.0):
        super().__init__()
        self.radius = positive("radius", radius)

    def kernel(self) -> Kernel:
        return Kernel(tent, (self.radius,), self.radius)


def tent(x: Tensor, radius: float) -> Tensor:
    """The tent function, 1 - |x| / radius."""
    return (1.0 - x.abs() / radius).clamp_min(0.0)
