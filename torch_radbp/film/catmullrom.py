"""The Catmull-Rom filter."""

from __future__ import annotations

from torch_radbp.film.filter import Filter, Kernel
from torch_radbp.film.mitchell import cubic
from torch_radbp.plugin import register


@register("rfilter", "catmullrom")
class CatmullRom(Filter):
    """A piecewise cubic function with a radius of 2 pixels that is sharp and rings: that of Mitchell with B = 0, C = 1/2."""

    def __init__(self) -> None:
        super().__init__()
        self.radius = 2.0

    def kernel(self) -> Kernel:
        return Kernel(cubic, (0.0, 0.5), self.radius)
