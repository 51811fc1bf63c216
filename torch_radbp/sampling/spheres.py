"""Directions and parallel rays towards some spheres, as if these were seen as discs of even brightness."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.sampling.warp import square_to_uniform_disk_concentric
from torch_radbp.tensors.vec import TINY, Frame, Vec2, Vec3, dot, where


class BoundingSphere(NamedTuple):
    """A sphere, () each; detached."""

    middle: Vec3
    radius: Tensor


class Towards(NamedTuple):
    """Sampled directions towards spheres, or points on rays that meet spheres, and their densities, (N,), detached."""

    d: Vec3  # unit direction, or a point
    density: Tensor  # over solid angle, or over the area across the rays
    size: Tensor  # solid angle, or area, of all spheres together; where they overlap it counts as often


def towards_spheres(spheres: Sequence[BoundingSphere], p: Vec3, choice: Tensor, across: Vec2) -> Towards:
    """Samples directions from points uniformly within the cones around spheres; all directions where a point is inside one.

    Args:
        spheres: at least one.
        p: (N,) the points, detached.
        choice, across: (N,) uniform numbers in [0, 1).
    """
    axes, caps = [], []  # a cap is 1 - cos of a cone's half angle
    for middle, radius in spheres:
        way = Vec3(*(c - part for c, part in zip(middle, p)))
        squared = dot(way, way).clamp_min(TINY)
        sine2 = radius * radius / squared
        axes.append(way * torch.rsqrt(squared))
        caps.append(torch.where(sine2 < 1.0, sine2 / (1.0 + torch.sqrt((1.0 - sine2).clamp_min(0.0))), 2.0))
    cap, axis, total = chosen_by_size(caps, axes, choice)
    z = 1.0 - cap * across.x
    r, phi = torch.sqrt((cap * across.x * (2.0 - cap * across.x)).clamp_min(0.0)), 2.0 * math.pi * across.y
    d = Frame.of(axis).to_world(Vec3(r * torch.cos(phi), r * torch.sin(phi), z))
    meets = [(1.0 - dot(d, axis)) <= cap for axis, cap in zip(axes, caps)]
    return Towards(d, covering(meets, d.x) / (2.0 * math.pi * total), 2.0 * math.pi * total)


def rays_to_spheres(spheres: Sequence[BoundingSphere], d: Vec3, choice: Tensor, across: Vec2) -> Towards:
    """Samples points on parallel rays through spheres, evenly over the discs in which these are seen.

    Args:
        spheres: at least one.
        d: (N,) unit direction of the rays, detached.
        choice, across: as for `towards_spheres`.

    Returns:
        The points in the planes across the rays through the middles.
    """
    middles = [Vec3(*(c.expand_as(d.x) for c in sphere.middle)) for sphere in spheres]
    radii = [sphere.radius.expand_as(d.x) for sphere in spheres]
    square, middle, total = chosen_by_size([radius * radius for radius in radii], middles, choice)
    disk, radius = square_to_uniform_disk_concentric(across.x, across.y), torch.sqrt(square)
    s, t, _ = Frame.of(d)
    p = middle + (s * disk.x + t * disk.y) * radius
    meets = []
    for other, reach in zip(middles, radii):
        apart = p - other
        along = dot(apart, d)
        meets.append(dot(apart, apart) - along * along <= reach * reach)
    return Towards(p, covering(meets, d.x) / (math.pi * total), math.pi * total)


def chosen_by_size(sizes: Sequence[Tensor], values: Sequence[Vec3], choice: Tensor) -> tuple[Tensor, Vec3, Tensor]:
    """Chooses one of several sizes in proportion to them; that size, its value, and the sum of all sizes, (N,)."""
    total = sum(sizes)
    left, end = choice * total, torch.zeros_like(choice)
    size, value = sizes[-1], values[-1]
    chosen = torch.zeros_like(choice, dtype=torch.bool)
    for own, of_it in zip(sizes[:-1], values[:-1]):
        end = end + own
        here = (left < end) & ~chosen
        size, value, chosen = torch.where(here, own, size), where(here, of_it, value), chosen | here
    return size, value, total


def covering(meets: Sequence[Tensor], like: Tensor) -> Tensor:
    """How many conditions hold, at least 1: but for rounding the sampled sphere's does."""
    return sum(condition.to(like.dtype) for condition in meets).clamp_min(1.0)
