"""Light from lights without extent, which have a pose: points, spots, projectors and directional lights."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.lookup import lookup
from torch_radbp.scene.tensors import DIRECTIONAL, PROJECTOR, SPOT, SceneTensors
from torch_radbp.vec import Frame, Vec2, Vec3, dot, where

NEAREST = 1e-9  # the least distance that counts; 1 / NEAREST^4 is finite in float32
FLATTEST = 1e-4  # cosine with a light's axis below which its image is not read


class Illumination(NamedTuple):
    """The light that reaches a point from a posed light; attached to the point and to the pose."""

    d: Vec3  # unit direction towards it
    place: Vec3  # its position, if it has one
    strength: Tensor  # factor of its texture: 1 / distance^2, and fall-off over directions
    uv: Vec2 | None  # where to read its texture; None if the intensity of no light of the scene depends on the direction


def illumination(scene: SceneTensors, p: Vec3, row: Tensor, kind: Tensor) -> Illumination:
    """The light that reaches the points `p` from the lights in rows `row` of the table, of kind `kind`; (N,)."""
    posed, layout = scene.lights.posed, scene.layout
    place = lookup(posed.place, row)
    reach = place - p
    squared = dot(reach, reach).clamp_min(NEAREST**2)
    d, strength, uv = reach * torch.rsqrt(squared), 1.0 / squared, None
    if layout.spots or layout.projectors:
        profile, uv = directional_profile(scene, -d, row, kind)
        strength = strength * profile
    if layout.directional_lights:
        directional = kind == DIRECTIONAL
        d, strength = where(directional, place, d), torch.where(directional, 1.0, strength)
    return Illumination(d, place, strength, uv)


def directional_profile(scene: SceneTensors, d: Vec3, row: Tensor, kind: Tensor) -> tuple[Tensor, Vec2]:
    """The variation of intensity over the directions `d` in which light leaves: a factor, and texture coordinates.

    A projector's intensity is that of a flat, evenly lit screen: 1 / cos^3 of the angle with its axis, where the image is. A
    spot's falls off linearly with that angle. Other lights have factor 1.
    """
    posed, layout = scene.lights.posed, scene.layout
    local = Frame(*(lookup(axis, row) for axis in posed.to_local)).to_local(d)
    local = local * torch.rsqrt(dot(local, local).clamp_min(NEAREST**2))
    ahead = local.z.clamp_min(FLATTEST)
    to_uv = lookup(posed.to_uv, row)
    uv = Vec2(0.5 + to_uv.x * local.x / ahead, 0.5 + to_uv.y * local.y / ahead)
    inside = (local.z > FLATTEST) & (uv.x >= 0) & (uv.x <= 1) & (uv.y >= 0) & (uv.y <= 1)
    uv = Vec2(torch.where(inside, uv.x, 0.5), torch.where(inside, uv.y, 0.5))
    profile = torch.ones_like(ahead)
    if layout.projectors:
        profile = torch.where(kind == PROJECTOR, inside.to(profile.dtype) / (ahead * ahead * ahead), profile)
    if layout.spots:
        sine = torch.sqrt((local.x * local.x + local.y * local.y).clamp_min(NEAREST**2))
        remaining = (lookup(posed.cutoff, row) - torch.atan2(sine, local.z)) * lookup(posed.sharpness, row)
        profile = torch.where(kind == SPOT, remaining.clamp(0.0, 1.0), profile)
    return profile, uv
