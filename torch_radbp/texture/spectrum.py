"""Spectra, which the path tracer sees as colours."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.plugin import Emitter, Plugin, Texture, finite
from torch_radbp.plugin.domain import AMOUNT, FRACTION, Domain
from torch_radbp.texture.colour import Colour
from torch_radbp.texture.observer import Role, at_wavelengths, linear_srgb, unclipped

GAMUT = 1e-6  # how far a colour may be outside without notice: rounding


class Samples(NamedTuple):
    """A spectrum as values at wavelengths, between which it is linear and beyond which it is zero."""

    wavelengths: tuple[float, ...]  # nanometres, increasing
    values: tuple[float, ...]

    def check(self) -> Samples:
        """Checks the samples and returns them.

        Raises:
            ValueError: if there are less than two, if a number is not finite, or if wavelengths do not increase.
        """
        nodes, values = self
        if len(nodes) != len(values):
            raise ValueError(f"a spectrum must have as many values as wavelengths, got {len(values)} and {len(nodes)}")
        if len(nodes) < 2:
            raise ValueError(f"a spectrum must have at least two wavelengths, got {len(nodes)}")
        wrong = next((number for number in (*nodes, *values) if not math.isfinite(number)), None)
        if wrong is not None:
            raise ValueError(f"a spectrum must be made of finite numbers, got {wrong}")
        wrong = next(((a, b) for a, b in zip(nodes, nodes[1:]) if a >= b), None)
        if wrong is not None:
            raise ValueError(f"the wavelengths of a spectrum must increase, got {wrong[0]:g} and then {wrong[1]:g}")
        return self

    def colour(self, role: Role) -> Tensor:
        """(3,) linear sRGB in torch's default dtype, with a warning if it had to be clipped."""
        nodes, values = (torch.tensor(part, dtype=torch.float64) for part in self)
        return checked_colour(at_wavelengths(nodes, values), role).to(torch.get_default_dtype())


def checked_colour(spectrum: Tensor, role: Role) -> Tensor:
    """(3,) the colour of a spectrum given at `WAVELENGTHS`, with a warning if it had to be clipped; detached."""
    spectrum = spectrum.detach()
    wanted, shown = unclipped(spectrum, role), linear_srgb(spectrum, role)
    if (wanted - shown).abs().max() > GAMUT * max(1.0, float(wanted.abs().max())):
        colour = ", ".join(f"{number:.4g}" for number in wanted.tolist())
        warnings.warn(f"a spectrum has a colour outside of sRGB, linear {colour}, and is clipped", UserWarning, stacklevel=2)
    return shown


def role_of(owner: Plugin, domain: Domain) -> Role:
    """The role of a spectrum (light or reflectance) for an attribute with this domain."""
    if isinstance(owner, Emitter):
        return "emitted"
    return "reflected" if isinstance(owner, Texture) or domain.is_reflectance or domain.high == FRACTION.high else "index"


class Spectrum(Colour):
    """Base class of spectra; they become colours once their role (light or reflectance) is known."""

    role: Role | None = None

    def spectrum(self) -> Tensor:
        """(1000,) the spectrum at `WAVELENGTHS`, float64, attached."""
        raise TypeError(f"{type(self).__name__} does not define its spectrum")

    def assign(self, role: Role) -> None:
        """Sets the role of the spectrum: of light, or of a reflectance.

        Raises:
            ValueError: if it was said before, and differently.
        """
        if self.role not in (None, role):
            raise ValueError(f"the {self.type} spectrum is {self.role} in one place and {role} in another, and has another "
                             f"colour there: write it once for each")
        if self.role is None:
            checked_colour(self.spectrum(), role)
        self.role = role

    def colour(self) -> Tensor:
        """(3,) linear sRGB, attached; that of a reflectance while no role is set."""
        colour = linear_srgb(self.spectrum(), self.role or "reflected")
        return colour.to(next(self.parameters()).dtype)


class SampledSpectrum(Spectrum):
    """Base class of spectra given by `values` at some wavelengths, linear between them and zero beyond them."""

    value = None  # the same as a list of wavelengths and values: resolved into the others by constructors

    def domains(self) -> dict[str, Domain]:
        return {"values": AMOUNT._replace(shapes=(("N",),))}

    def nodes(self) -> Tensor:
        """(N,) the wavelengths, nanometres, increasing."""
        raise TypeError(f"{type(self).__name__} does not define its wavelengths")

    def spectrum(self) -> Tensor:
        """(1000,) the spectrum at `WAVELENGTHS`, float64, attached."""
        return at_wavelengths(self.nodes(), self.values)


def numbers(name: str, given: str | Tensor | Sequence[float]) -> Tensor:
    """(N,) numbers in torch's default dtype, from an array or a text that commas or blanks separate.

    Raises:
        ValueError: if one cannot be read, or the shape is another.
    """
    if isinstance(given, str):
        try:
            given = [float(word) for word in given.replace(",", " ").split()]
        except ValueError as error:
            raise ValueError(f"{name} must be made of numbers, {error}") from error
    tensor = finite(name, given).to(torch.get_default_dtype())
    if tensor.ndim != 1:
        raise ValueError(f"{name} must have shape (N,), got {tuple(tensor.shape)}")
    return tensor
