"""Mappings from the unit square to directions and points, with their densities."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torch_radbp.tensors.vec import Vec2, Vec3


def square_to_cosine_hemisphere(u: Tensor, v: Tensor) -> Vec3:
    """Directions around +z with density cos(theta) / pi."""
    r, phi = torch.sqrt(u), 2.0 * math.pi * v
    return Vec3(r * torch.cos(phi), r * torch.sin(phi), torch.sqrt((1.0 - u).clamp_min(0.0)))


def cosine_hemisphere_pdf(w: Vec3) -> Tensor:
    """Density of `square_to_cosine_hemisphere` over solid angle; zero below the horizon."""
    return w.z.clamp_min(0.0) * (1.0 / math.pi)


def square_to_uniform_sphere(u: Tensor, v: Tensor) -> Vec3:
    """Directions uniform over the sphere, with density 1 / (4 pi)."""
    z = 1.0 - 2.0 * u
    r, phi = torch.sqrt((1.0 - z * z).clamp_min(0.0)), 2.0 * math.pi * v
    return Vec3(r * torch.cos(phi), r * torch.sin(phi), z)


UNIFORM_SPHERE_PDF = 1.0 / (4.0 * math.pi)


def square_to_uniform_disk_concentric(u: Tensor, v: Tensor) -> Vec2:
    """Points of the unit disk, uniform over its area; neighbours in the square stay neighbours.

    Reference: Shirley and Chiu 1997, "A Low Distortion Map Between Disk and Square".
    """
    x, y = 2.0 * u - 1.0, 2.0 * v - 1.0
    upright = x.abs() < y.abs()
    r, other = torch.where(upright, y, x), torch.where(upright, x, y)
    phi = (0.25 * math.pi) * other / torch.where(r == 0, 1.0, r)
    phi = torch.where(upright, 0.5 * math.pi - phi, phi)
    return Vec2(r * torch.cos(phi), r * torch.sin(phi))


def square_to_uniform_triangle(u: Tensor, v: Tensor) -> Vec2:
    """Barycentric coordinates of the second and third vertex, uniform over the triangle's area."""
    root = torch.sqrt(u)
    return Vec2(root * (1.0 - v), root * v)
