"""A spectrum given at any wavelengths."""

from __future__ import annotations

from torch import Tensor

from torch_radbp.plugin import register
from torch_radbp.texture.spectrum import SampledSpectrum, Samples, numbers


@register("texture", "irregular")
class Irregular(SampledSpectrum):
    """A spectrum of values at some wavelengths, linear between them, zero beyond them.

    Mitsuba 3.9 renders it in its spectral modes only. Here it has the colour that it has there, of a reflectance under
    daylight.

    Parameters: `values`, (N,). Derivatives: with respect to the values; none for a channel of a colour that is clipped.

    Args:
        wavelengths: nanometres, increasing; an array or a text with commas or blanks between them. Either these two or
            `value`.
        values: as many.
        value: the same as a list of wavelengths and values; Mitsuba writes `<spectrum name="value" value="400:0.1, ..."/>`.

    Raises:
        ValueError: if there are less than two, if wavelengths do not increase, or if a value is negative.
    """

    def __init__(self, *, wavelengths: str | Tensor | None = None, values: str | Tensor | None = None,
                 value: Samples | None = None):
        super().__init__()
        missing = (wavelengths is None) + (values is None)
        if missing != (0 if value is None else 2):
            raise ValueError("an irregular spectrum needs either wavelengths and values, or value")
        if value is not None:
            wavelengths, values = value.check()
        wavelengths, values = numbers("wavelengths", wavelengths), numbers("values", values)
        Samples(tuple(wavelengths.tolist()), tuple(values.tolist())).check()
        self.register_buffer("wavelengths", wavelengths)
        self.freeze("values", values)

    def nodes(self) -> Tensor:
        return self.wavelengths
