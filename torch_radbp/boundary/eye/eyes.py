"""Viewpoints from which silhouette edges are sampled."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.tensors.vec import Vec3, dot

COPLANAR = 1e-6  # a cosine; what lies in the plane of an eye's surface hides nothing from it
NARROWEST = 400.0  # that lobes may be, so that what lies beside them is not forgotten
MOST_DENSE = 1e6  # per steradian, of a lobe; beyond are points on a light or in its plane, where rounding decides


class Lobe(NamedTuple):
    """Directions that count more for a viewpoint, as of light or of a glossy lobe; (M,)."""

    d: Vec3  # unit, centre
    narrow: Tensor  # weight over squared angular radius; 0: no lobe


class Eyes(NamedTuple):
    """M viewpoints from which edges are sampled; detached, float64."""

    place: Vec3  # (M,)
    w: Tensor  # (M,) 1; 0: `place` is a direction
    n: Vec3  # (M,) unit normal of its surface, 0: on none; directions count by their cosine,
    behind: Tensor  # (M,) behind the surface by this factor less,
    even: Tensor  # (M,) plus this constant, except along the surface
    lobes: tuple[Lobe, ...] = ()  # directions that count more


def how_much_counts(eye: Eyes, d: Vec3, cosine: Tensor | float = 1.0, sine: Tensor | float = 0.0) -> Tensor:
    """A bound of the weights of directions within a cone, for sampling edges; (N,).

    Args:
        eye: (N,).
        d: (N,) unit.
        cosine, sine: of the angle up to which others lie off these.
    """
    faced = dot(eye.n, d).clamp(-1.0, 1.0)
    across = torch.sqrt(1.0 - faced * faced)
    before, behind = (torch.where(side >= cosine, 1.0, side * cosine + across * sine) for side in (faced, -faced))
    faced = torch.maximum(before, eye.behind * behind)
    along = torch.where(dot(eye.n, eye.n) > 0.0, torch.zeros_like(faced), 1.0)
    return torch.where(faced > COPLANAR, faced + eye.even, along)


def lobe_around(d: Vec3, density: Tensor) -> Lobe:
    """The lobe around directions of given solid-angle density, (N,); none above `MOST_DENSE`, or for 0."""
    narrow = torch.where(density < MOST_DENSE, torch.pi * density, 0.0)
    return Lobe(d.map(torch.Tensor.double), narrow.double().clamp(0.0, NARROWEST))


def how_much_lobes_count(eye: Eyes, d: Vec3, squared: Tensor) -> Tensor:
    """The mean factor by which a viewpoint's lobes raise the weight of a cone of directions, (N,).

    Every lobe counts half as much as all other directions.

    Args:
        eye: (N,).
        d: (N,) unit.
        squared: (N,) squares of the angular radii of the cones.
    """
    counts = torch.ones_like(squared)
    for lobe in eye.lobes:
        wide, off = lobe.narrow / (1.0 + lobe.narrow * squared), d - lobe.d
        near = 1.0 + wide * dot(off, off)
        counts = counts + wide / (near * near)
    return counts
