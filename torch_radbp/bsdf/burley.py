"""Burley's shading model: what the materials `principled` and `principledthin` share.

Names, ranges and constants are Mitsuba's.

Reference: Burley 2012, "Physically Based Shading at Disney"; Burley 2015, "Extending the Disney BRDF to a BSDF with
Integrated Subsurface Scattering".
"""

from __future__ import annotations

import torch
from torch import Tensor

from torch_radbp.bsdf.features import Number
from torch_radbp.bsdf.fresnel import dielectric_reflectance
from torch_radbp.bsdf.microfacet import GGX
from torch_radbp.interface.texture import LUMINANCE
from torch_radbp.plugin.domain import FRACTION
from torch_radbp.tensors.vec import Vec3, attached

SMALLEST_ALPHA = 1e-3  # a smoother surface counts as this rough
SMALLEST_ROUGHNESS = SMALLEST_ALPHA**0.5
ROUGHNESS = FRACTION._replace(floor=SMALLEST_ROUGHNESS / 0.1**0.25)  # domain; the floor if facets are stretched most
LEAST_SHARE = 0.02  # of a lobe's weight when lobes are chosen: one of weight zero is still sampled, and has a derivative
DARKEST = 1e-6  # luminance below which a colour loses its tint
SMALLEST_COSINE = 1e-6  # of a sum of two
ROUNDED = 1e-8  # where the root of a channel is rounded off: its slope is infinite at zero


def check_rates(rates: dict[str, float], needed: str) -> None:
    """Raises ValueError if a lobe's sampling rate is negative or not finite, or the one that is `needed` is zero."""
    for name, rate in rates.items():
        if not (rate > 0 or (rate == 0 and name != needed)) or rate == float("inf"):
            least = "greater than" if name == needed else "at least"
            raise ValueError(f"{name} must be {least} 0 and finite, got {rate}")


def at_least_some(weight: Number) -> Number:
    """The weight of a lobe with which it is selected: at least `LEAST_SHARE`."""
    return weight.clamp_min(LEAST_SHARE) if isinstance(weight, Tensor) else max(weight, LEAST_SHARE)


def square_root(channel: Tensor) -> Tensor:
    """The square root of a colour channel, with a finite derivative at zero."""
    return channel * torch.rsqrt(channel.clamp_min(0.0) + ROUNDED)


def fifth_power(cosine: Tensor) -> Tensor:
    """Schlick's weight of grazing angles, (1 - cosine)^5."""
    rest = (1.0 - cosine).clamp(0.0, 1.0)
    square = rest * rest
    return square * square * rest


def schlick_weight(cos_i: Tensor, eta: Tensor) -> Tensor:
    """Schlick's weight at a boundary; seen from the denser side, by the cosine of refraction.

    Args:
        cos_i: at least 0, between the direction of incidence and the normal on its side.
        eta: index of refraction on the far side over the one on the near side.
    """
    _, cos_t = dielectric_reflectance(cos_i, eta)
    return fifth_power(torch.where(eta > 1.0, cos_i, cos_t))


def mixed(first: Number, second: Number, share: Number) -> Number:
    """Linear interpolation: `first` where the share is 0, `second` where it is 1."""
    return first + (second - first) * share


def normal_reflectance(eta: Tensor) -> Tensor:
    """The Fresnel reflectance of a dielectric boundary at normal incidence."""
    root = (eta - 1.0) / (eta + 1.0)
    return root * root


def tint_of(colour: Vec3) -> Vec3:
    """A colour over its luminance; white for black, and nearly so where the luminance is not far above `DARKEST`."""
    luminance = sum(weight * channel for weight, channel in zip(LUMINANCE, colour))
    scale = 1.0 / (luminance.clamp_min(0.0) + DARKEST)
    return colour.map(lambda channel: (channel + DARKEST) * scale)


def facets_of(roughness: Tensor, anisotropic: Number) -> GGX:
    """The GGX distribution for a roughness in [0, 1], stretched along u by an anisotropy in [0, 1].

    Where a width is below `SMALLEST_ALPHA` it counts as that, with the derivative of a roughness of `SMALLEST_ROUGHNESS`.
    """
    aspect = torch.sqrt(1.0 - 0.9 * anisotropic) if isinstance(anisotropic, Tensor) else 1.0
    fixed = roughness.detach()
    source = (roughness + (fixed.clamp_min(SMALLEST_ROUGHNESS) - fixed)).square()
    square = fixed.square()

    def width(stretch: Number) -> Tensor:
        constant = stretch.detach() if isinstance(stretch, Tensor) else stretch
        return attached((square * constant).clamp_min(SMALLEST_ALPHA), source * stretch)

    return GGX(width(1.0 / aspect), width(aspect))


def base_profile(cos_i: Tensor, cos_o: Tensor, cos_d: Tensor, roughness: Tensor, flatness: Tensor | None) -> Tensor:
    """Burley's diffuse base relative to a Lambertian one: darker at grazing angles, brighter back to the light.

    Args:
        cos_i, cos_o: of both directions, at least 0.
        cos_d: between either direction and the half vector.
        flatness: how much of it is replaced by an approximation of subsurface scattering; None: nothing.

    Reference: Burley 2015, equation 4, and section 5.3 of Burley 2012, after Hanrahan and Krueger 1993.
    """
    grazing_i, grazing_o, retro = fifth_power(cos_i), fifth_power(cos_o), 2.0 * roughness * cos_d * cos_d
    diffuse = (1.0 - 0.5 * grazing_i) * (1.0 - 0.5 * grazing_o)
    profile = diffuse + retro * (grazing_o + grazing_i + grazing_o * grazing_i * (retro - 1.0))
    if flatness is None:
        return profile
    spread = mixed(1.0, 0.5 * retro, grazing_o) * mixed(1.0, 0.5 * retro, grazing_i)
    flat = 1.25 * (spread * (1.0 / (cos_i + cos_o).clamp_min(SMALLEST_COSINE) - 0.5) + 0.5)
    return mixed(profile, flat, flatness)


def sheen_colour(colour: Vec3, sheen_tint: Tensor | None) -> Vec3:
    """The colour of the sheen: white, or between white and the tint of the base."""
    if sheen_tint is None:
        return Vec3.full(colour.x, 1.0)
    return tint_of(colour).map(lambda channel: mixed(1.0, channel, sheen_tint))
