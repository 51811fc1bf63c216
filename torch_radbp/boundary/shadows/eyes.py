"""Points that look at edges."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.tensors.vec import Vec3, dot

COPLANAR = 1e-6  # a cosine; what lies in the plane of an eye's surface hides nothing from it
NARROWEST = 400.0  # that lobes may be, so that what lies beside them is not forgotten
MOST_DENSE = 1e8  # per steradian, of a lobe; beyond are points in the plane of a light, where rounding decides


class Lobe(NamedTuple):
    """Directions from which more light comes, or is scattered, than from others; (M,), of an eye each."""

    d: Vec3  # unit, the middle
    narrow: Tensor  # over the square of its angular radius; 0: there is none


class Eyes(NamedTuple):
    """M points that look at edges, or directions towards such; detached, float64."""

    place: Vec3  # (M,)
    w: Tensor  # (M,) 1; 0: `place` is a direction towards the eye
    n: Vec3  # (M,) unit normal of the surface that it lies on, 0: on none; directions count by their cosines,
    behind: Tensor  # (M,) behind the surface so many times less,
    even: Tensor  # (M,) and so much, whatever the cosine, but along the surface
    lobes: tuple[Lobe, ...] = ()  # in which they count more


def how_much_counts(eye: Eyes, d: Vec3, cosine: Tensor | float = 1.0, sine: Tensor | float = 0.0) -> Tensor:
    """The most that directions around some count, (N,).

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
    """The lobe of which one direction and its density over solid angle are known, (N,); of more than `MOST_DENSE`, or of 0,
    there is none."""
    narrow = torch.where(density < MOST_DENSE, torch.pi * density, 0.0)
    return Lobe(d.map(torch.Tensor.double), narrow.double().clamp(0.0, NARROWEST))


def how_much_lobes_count(eye: Eyes, d: Vec3, squared: Tensor) -> Tensor:
    """How much more directions count for the lobes of eyes, in the mean of cones around them, (N,); 1: no more.

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
