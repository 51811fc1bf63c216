"""Bounds of lights for importance sampling: their intensity, extent and directions.

A light that is picked by its importance has bounds: a sphere that it lies in, the greatest intensity that it sends, and a
cone. `spread` is the angle between the axis and the farthest normal, `reach` the angle from a normal within which light
leaves, so that none leaves farther than `spread + reach` from the axis. Several lights have bounds together.

Reference: Conty Estevez and Kulla 2018, "Importance Sampling of Many Lights with Adaptive Tree Splitting", section 4.1.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.tensors.vec import Vec3, angle_between, normalize

LEEWAY = 1e-3  # relative, of radii, and in radians, of angles: rounding must not put light outside of its bounds
LEAST_LENGTH = 1e-3  # of the mean of some unit vectors: shorter ones have no axis in common


class LightBounds(NamedTuple):
    """Bounds of K lights' position, intensity and directions, (K,); detached."""

    middle: Vec3  # centre of the bounding sphere, world space
    radius: Tensor
    intensity: Tensor  # luminance times area, or luminance of a point light's intensity
    axis: Vec3  # unit, of the cone of normals
    spread: Tensor  # radians, angle of that cone; pi: every direction
    reach: Tensor  # radians, greatest angle between a normal and emitted light

    @staticmethod
    def at(middle: Vec3, intensity: Tensor) -> LightBounds:
        """The bounds of point lights that shine into every direction."""
        zero = torch.zeros_like(intensity)
        return LightBounds(middle, zero, intensity, Vec3(zero, zero, zero + 1.0), zero + math.pi, zero + math.pi / 2)


def bounds_of_groups(bounds: LightBounds, group: Tensor, count: int) -> LightBounds:
    """Merges the bounds of K lights to those of `count` groups.

    Args:
        bounds: of the lights.
        group: (K,) int64. A group without a light has the intensity 0.
    """
    def least(values: Tensor, largest: bool = False) -> Tensor:
        start = values.new_full((count,), -math.inf if largest else math.inf)
        reduced = start.scatter_reduce(0, group, values, "amax" if largest else "amin")
        return torch.where(reduced.isinf(), 0.0, reduced)

    def total(values: Tensor) -> Tensor:
        return values.new_zeros(count).index_add_(0, group, values)

    low, high = (bounds.middle.map(lambda c, sign=sign: least(c + sign * bounds.radius, sign > 0)) for sign in (-1, 1))
    middle = (low + high) * 0.5
    from_middle = bounds.middle - middle.map(lambda c: c[group])
    radius = least(torch.linalg.vector_norm(from_middle.stack(), dim=-1) + bounds.radius, largest=True)
    # Directions weigh by intensity, but each counts for something.
    weight = bounds.intensity / bounds.intensity.max().clamp_min(1e-300) + LEEWAY
    mean = (bounds.axis * weight).map(total)
    length = torch.linalg.vector_norm(mean.stack(), dim=-1) / total(weight).clamp_min(1e-300)
    axis = normalize(mean)
    apart = angle_between(bounds.axis, axis.map(lambda c: c[group]))
    spread = least(apart + bounds.spread, largest=True)
    spread = torch.where(length > LEAST_LENGTH, spread, math.pi)
    return LightBounds(middle, radius, total(bounds.intensity), axis, spread.clamp_max(math.pi),
                       least(bounds.reach, largest=True))
