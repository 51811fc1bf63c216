"""Fresnel's equations: the fraction of unpolarised light that an interface reflects.

Two remarks on numerics. The complex root in a conductor's reflectance is computed from that of its two parts which does not
cancel, so that a perfect mirror (eta = 0) has a derivative. The cosine of refraction has an infinite derivative at the
critical angle; the argument of its root is kept above the rounding unit, which bounds the derivative and hardly changes
the value.

Reference: Born and Wolf 1999, "Principles of Optics", sections 1.5.2 and 14.2; Lagarde 2013, "Memo on Fresnel equations".
"""

from __future__ import annotations

import torch
from torch import Tensor

from torch_radbp.tensors.vec import Vec3

SMALLEST_COSINE = 1e-12
SMALLEST_INDEX = 1e-20  # of the squared modulus of eta^2 - k^2 - sin^2 + 2 i eta k
GREATEST_INDEX = 1e6  # of a conductor: greater numbers count as this one, whose powers float32 holds


def dielectric_reflectance(cos_i: Tensor, eta: Tensor) -> tuple[Tensor, Tensor]:
    """Fresnel reflectance of a boundary between dielectrics, and the cosine of the refracted direction.

    Args:
        cos_i: at least 0, between the direction of incidence and the normal on its side.
        eta: index of refraction on the far side over the one on the near side.

    Returns:
        The reflectance, and the cosine of refraction, at least 0; 1 and 0 at total internal reflection.
    """
    cos_i = cos_i.clamp_min(SMALLEST_COSINE)
    inverse = 1.0 / eta
    cos2_t = 1.0 - inverse * inverse * (1.0 - cos_i * cos_i)
    cos_t = torch.sqrt(cos2_t.clamp_min(torch.finfo(cos_i.dtype).eps)) * (cos2_t > 0).to(cos_i.dtype)
    return unpolarised(cos_i, cos_t, eta), cos_t


def unpolarised(cos_i: Tensor, cos_t: Tensor, eta: Tensor) -> Tensor:
    """Fresnel reflectance of a dielectric boundary, by the cosines of incidence and refraction, not both zero."""
    perpendicular = (cos_i - eta * cos_t) / (cos_i + eta * cos_t)
    parallel = (eta * cos_i - cos_t) / (eta * cos_i + cos_t)
    return 0.5 * (perpendicular * perpendicular + parallel * parallel)


def conductor_reflectance(cos_i: Tensor, eta: Vec3, k: Vec3) -> Vec3:
    """Fresnel reflectance of a conductor seen from vacuum.

    Args:
        cos_i: between the direction of incidence and the normal, at least 0.
        eta, k: real and imaginary part of the index of refraction, at least 0; at most `GREATEST_INDEX` counts.
    """
    return Vec3(*(_conductor_channel(cos_i, *index) for index in zip(eta, k)))


def _conductor_channel(cos_i: Tensor, eta: Tensor, k: Tensor) -> Tensor:
    eta, k = eta.clamp_max(GREATEST_INDEX), k.clamp_max(GREATEST_INDEX)
    cos2, sin2 = cos_i * cos_i, 1.0 - cos_i * cos_i
    # (a + i b)^2 = (eta + i k)^2 - sin^2, its real part and its modulus.
    real = eta * eta - k * k - sin2
    product = eta * k  # a b
    modulus = torch.sqrt(real * real + 4.0 * product * product + SMALLEST_INDEX)
    larger = torch.sqrt(0.5 * (modulus + real.abs()))
    positive = real >= 0
    # a = scaled / scale. All that follows is multiplied by `scale`, so that there is one division in the end.
    scaled, scale = torch.where(positive, larger, product), torch.where(positive, 1.0, larger)
    # With mod = |a + i b|^2: Rs = |cos - (a + i b)|^2 / |cos + (a + i b)|^2, and (1 + Rp / Rs) / 2 in the same terms.
    even, odd = (modulus + cos2 + SMALLEST_COSINE) * scale, 2.0 * scaled * cos_i
    other = (cos2 * modulus + sin2 * sin2 + SMALLEST_COSINE) * scale
    return (even - odd) * other / ((even + odd) * (other + odd * sin2))
