"""Blackbody radiation as a texture."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_radbp.plugin import finite, register
from torch_radbp.plugin.domain import NUMBER, Domain
from torch_radbp.texture.observer import WAVELENGTHS, Role
from torch_radbp.texture.spectrum import Spectrum

LIGHT = 2.99792458e8  # speed, m / s
PLANCK = 6.62607004e-34  # J s, with Mitsuba's digits, as the next
BOLTZMANN = 1.38064852e-23  # J / K
TEMPERATURE = NUMBER._replace(low=0.0, low_is_in=False, limit=1e7)


@register("texture", "blackbody")
class Blackbody(Spectrum):
    """The radiance of a black body by Planck's law, in W / (m^2 sr nm); of emitters only.

    Mitsuba 3.9 renders it in its spectral modes only. Here it has the colour and the brightness that it has there: at 5000 K
    about 15,000 in red, so that scenes are in metres, and exposures low.

    Parameters: `temperature`, (). Derivatives: with respect to it.

    Args:
        temperature: kelvins.
        wavelength_min, wavelength_max: nanometres; there is no light beyond them.

    Raises:
        ValueError: if the temperature is not greater than zero, if wavelengths do not increase, or in the place of anything
            but light.

    Reference: Planck 1901, "On the Law of Distribution of Energy in the Normal Spectrum".
    """

    def __init__(self, *, temperature: float, wavelength_min: float = 360.0, wavelength_max: float = 830.0):
        super().__init__()
        if not wavelength_min < wavelength_max:
            raise ValueError(f"wavelength_min must be less than wavelength_max, got {wavelength_min} and {wavelength_max}")
        self.wavelength_min, self.wavelength_max = float(wavelength_min), float(wavelength_max)
        self.freeze("temperature", finite("temperature", temperature, ()).to(torch.get_default_dtype()))

    def domains(self) -> dict[str, Domain]:
        return {"temperature": TEMPERATURE}

    def assign(self, role: Role) -> None:
        if role != "emitted":
            raise ValueError("a blackbody is light and can stand in an emitter only; a surface takes an rgb or a spectrum")
        super().assign(role)

    def spectrum(self) -> Tensor:
        """(1000,) the radiance at `WAVELENGTHS`, float64, attached."""
        nanometres = torch.as_tensor(WAVELENGTHS, device=self.temperature.device)
        metres = nanometres * 1e-9
        # Not of the whole fraction: its denominator overflows where there is no light.
        falloff = torch.exp(-PLANCK * LIGHT / BOLTZMANN / (metres * self.temperature.double()))
        radiance = 2e-9 * PLANCK * LIGHT**2 / metres**5 * falloff / (1.0 - falloff)
        seen = (nanometres >= self.wavelength_min) & (nanometres <= self.wavelength_max)
        return torch.where(seen, radiance, 0.0)
