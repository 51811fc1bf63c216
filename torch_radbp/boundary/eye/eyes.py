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
    """Directions to which a viewpoint gives more weight, as those of light or of a glossy lobe; (M,)."""

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
    """An upper bound of the sampling weights of edges in a cone of directions from viewpoints; (N,).

    Args:
        eye: (N,) the viewpoints.
        d: (N,) unit, the axes of the cones.
        cosine, sine: of the cones' half angles.
    """
    faced = dot(eye.n, d).clamp(-1.0, 1.0)
    across = torch.sqrt(1.0 - faced * faced)
    before, behind = (torch.where(side >= cosine, 1.0, side * cosine + across * sine) for side in (faced, -faced))
    faced = torch.maximum(before, eye.behind * behind)
    along = torch.where(dot(eye.n, eye.n) > 0.0, torch.zeros_like(faced), 1.0)
    return torch.where(faced > COPLANAR, faced + eye.even, along)


def lobe_around(d: Vec3, density: Tensor) -> Lobe:
    """The lobe around directions d of given solid-angle densities, (N,); none if the density is 0 or above `MOST_DENSE`."""
    narrow = torch.where(density < MOST_DENSE, torch.pi * density, 0.0)
    return Lobe(d.map(torch.Tensor.double), narrow.double().clamp(0.0, NARROWEST))


def how_much_lobes_count(eye: Eyes, d: Vec3, squared: Tensor) -> Tensor:
    """The mean factor by which viewpoints' lobes raise the weights of cones of directions, (N,).

    The weight of a lobe is half that of all other directions.

    Args:
        eye: (N,) the viewpoints.
        d: (N,) unit, the axes of the cones.
        squared: (N,) squares of the angular radii of the cones.
    """
    counts = torch.ones_like(squared)
    for lobe in eye.lobes:
        wide, off = lobe.narrow / (1.0 + lobe.narrow * squared), d - lobe.d
        near = 1.0 + wide * dot(off, off)
        counts = counts + wide / (near * near)
    return counts
