"""The box filter."""

from __future__ import annotations

from torch_radbp.film.filter import Filter, Kernel, constant
from torch_radbp.plugin import positive, register


@register("rfilter", "box")
class Box(Filter):
    """Constant within `radius` pixels of the centre (one pixel wide by default).

    Args:
        radius: pixels.
    """

    def __init__(self, *, radius: float = 0.5):
        super().__init__()
        self.radius = positive("radius", radius)

    def kernel(self) -> Kernel:
        return Kernel(constant, (self.radius,), self.radius)
