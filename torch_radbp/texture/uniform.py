"""A spectrum that is constant over wavelengths."""

from __future__ import annotations

from torch import Tensor

from torch_radbp.plugin import register
from torch_radbp.texture.rgb import RGB


@register("texture", "uniform")
class Uniform(RGB):
    """A constant with the same value in all channels: in an emitter, too, as in Mitsuba's RGB modes.

    Parameters: `value`, (). Derivatives: with respect to it.

    Args:
        value: the value.
        wavelength_min, wavelength_max: where Mitsuba's spectral modes take it; of no effect in RGB, there and here.
    """

    def __init__(self, *, value: Tensor | float = 1.0, wavelength_min: float = 360.0, wavelength_max: float = 830.0):
        super().__init__(value=value)
        self.wavelength_min, self.wavelength_max = float(wavelength_min), float(wavelength_max)
