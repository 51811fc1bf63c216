"""A spectrum given at equidistant wavelengths."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_radbp.plugin import register
from torch_radbp.texture.spectrum import SampledSpectrum, Samples, numbers


@register("texture", "regular")
class Regular(SampledSpectrum):
    """A spectrum of values at equidistant wavelengths, linear between them, zero beyond them.

    Mitsuba 3.9 renders it in its spectral modes only. Here it has the colour that it has there, of a reflectance under
    daylight.

    Parameters: `values`, (N,). Derivatives: with respect to the values; none for a channel of a colour that is clipped.

    Args:
        wavelength_min: of the first value, nanometres. Either these three or `value`.
        wavelength_max: of the last value.
        values: at least two, an array or a text with commas or blanks between them.
        value: the same as a list of wavelengths and values; Mitsuba writes `<spectrum name="value" value="400:0.1, ..."/>`.

    Raises:
        ValueError: if wavelengths are missing, do not increase or are not at equal steps, or if a value is negative.
    """

    def __init__(self, *, wavelength_min: float | None = None, wavelength_max: float | None = None,
                 values: str | Tensor | None = None, value: Samples | None = None):
        super().__init__()
        parts = {"wavelength_min": wavelength_min, "wavelength_max": wavelength_max, "values": values}
        missing = [name for name, part in parts.items() if part is None]
        if len(missing) != (0 if value is None else 3):
            raise ValueError("a regular spectrum needs either wavelength_min, wavelength_max and values, or value")
        if value is not None:
            (wavelength_min, *_, wavelength_max), values = value.check()
        values = numbers("values", values)
        nodes = torch.linspace(wavelength_min, wavelength_max, len(values), dtype=torch.float64)
        Samples(tuple(nodes.tolist()), tuple(values.tolist())).check()
        if value is not None and not torch.allclose(nodes, nodes.new_tensor(value.wavelengths)):
            raise ValueError("the wavelengths of a regular spectrum must be at equal steps, take an irregular one")
        self.wavelength_min, self.wavelength_max = wavelength_min, wavelength_max
        self.freeze("values", values)

    def nodes(self) -> Tensor:
        return torch.linspace(self.wavelength_min, self.wavelength_max, len(self.values), dtype=torch.float64,
                              device=self.values.device)
