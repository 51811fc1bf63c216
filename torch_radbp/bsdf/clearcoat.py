"""The thin clear coat of Burley's model: a weak reflection with a sharp peak and a long tail.

Its microfacets have the density

    D(m) = (a^2 - 1) / (pi ln(a^2) (1 + (a^2 - 1) cos^2))

and are sampled whether visible or not. Shadowing is that of a GGX surface of roughness 0.25, whatever a is.

Reference: Burley 2012, "Physically Based Shading at Disney", section 5.4 and appendix B, equations 4 and 5.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.tensors.vec import Vec3

DULL, GLOSSY = 0.1, 0.001  # roughness at a gloss of 0 and of 1
SHADOWING = 0.25**2  # squared roughness
SMALLEST = 1e-12


class Clearcoat(NamedTuple):
    """The microfacet distribution of a clear coat."""

    square: Tensor  # (N,) squared roughness, attached

    @staticmethod
    def of(gloss: Tensor) -> Clearcoat:
        """The distribution for a gloss in [0, 1]."""
        roughness = DULL + (GLOSSY - DULL) * gloss
        fixed = roughness.detach()  # of a gloss beyond 1, as finite differences may have it, less than zero
        return Clearcoat((roughness + (fixed.clamp_min(0.5 * GLOSSY) - fixed)).square())

    def density(self, m: Vec3) -> Tensor:
        """D(m): area of microfacets with normal `m` per area of the surface and solid angle."""
        spread = m.x * m.x + m.y * m.y + self.square * m.z * m.z
        return (self.square - 1.0) / (math.pi * torch.log(self.square) * spread)

    def sample(self, u: Tensor, v: Tensor) -> Vec3:
        """Samples microfacet normals with density D(m) times cosine."""
        sine2 = self.square * (torch.exp(-v * torch.log(self.square)) - 1.0) / (1.0 - self.square)
        sine2 = sine2.clamp_min(SMALLEST)
        sine, phi = torch.sqrt(sine2), 2.0 * math.pi * u
        return Vec3(sine * torch.cos(phi), sine * torch.sin(phi), torch.sqrt((1.0 - sine2).clamp_min(SMALLEST)))


def shadowing(w: Vec3) -> Tensor:
    """Smith's shadowing of the coat: the fraction of it that is visible from `w`, above the surface."""
    return 2.0 * w.z / (w.z + torch.sqrt(w.z * w.z + SHADOWING * (w.x * w.x + w.y * w.y)))
