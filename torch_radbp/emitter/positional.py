"""What point lights, spots and projectors have in common: light from a point."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import torch
from torch import Tensor

from torch_radbp.emitter.attributes import linear_inverse
from torch_radbp.interface.emitter import NEAREST, Aim, LightKind, Pick, RayNumbers, ShadowSource, Surrounding, Table
from torch_radbp.sampling.spheres import towards_spheres
from torch_radbp.sampling.warp import UNIFORM_SPHERE_PDF, square_to_uniform_sphere
from torch_radbp.tensors.differentiated import settled
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.vec import Frame, Vec2, Vec3, attached, cross, dot, normalize, where

FLATTEST = 1e-4  # cosine with a light's axis below which its image is not read


@dataclass(frozen=True)
class PositionalKind(LightKind):
    """Lights at a point (column `place` of the table), whose irradiance falls with the square of the distance."""

    delta: ClassVar[bool] = True
    bounded: ClassVar[bool] = True

    def aim(self, table: Table, proposal: Table, p: Vec3, pick: Pick) -> Aim:
        light = lookup(table, pick.row)
        reach = light.place - p
        squared = dot(reach, reach).clamp_min(NEAREST**2)
        d, strength = reach * torch.rsqrt(squared), 1.0 / squared
        profile, uv = self.profile(light, -d)
        return Aim(d, pick.pmf, light.place, strength if profile is None else strength * profile, uv)

    def emit(self, table: Table, proposal: Table, pick: Pick, numbers: RayNumbers, world: Surrounding) -> Aim:
        light = lookup(table, pick.row)
        d, density = self.beam(light, numbers.across)
        if world.targets and self.aimed:
            aimed, there, size = towards_spheres(world.targets, light.place.map(settled), numbers.target, numbers.across)
            narrower = size * settled(density) < 1.0  # than the beam
            d, density = where(narrower, aimed, d), torch.where(narrower, there, density)
        if numbers.met is not None and self.aimed:
            d, density = attached(d.map(settled), normalize(numbers.met - light.place)), settled(density)
        strength, uv = self.profile(light, d)
        return Aim(d, pick.pmf * density, light.place, strength, uv)

    def beam(self, light: Table, across: Vec2) -> tuple[Vec3, Tensor]:
        """Samples unit directions in which light leaves, with their density over solid angle; attached to the light.

        Args:
            across: (N,) uniform numbers in [0, 1).
        """
        return square_to_uniform_sphere(across.x, across.y), torch.full_like(across.x, UNIFORM_SPHERE_PDF)

    def profile(self, light: Table, d: Vec3) -> tuple[Tensor | None, Vec2 | None]:
        """The relative intensity in the unit directions `d` in which light leaves, attached.

        Returns:
            A factor (None: 1), and where to read the texture (None: it is one texel).
        """
        return None, None


    def leaving(self, light: Table, uv: Vec2) -> Vec3:
        """The world directions, (N,) of any length, in which light leaves through positions `uv` of its image; attached."""
        return Screen.towards(light.to_local, light.to_uv, uv)


class Screen(NamedTuple):
    """Directions seen from a light, and where they meet its image; (N,), attached."""

    local: Vec3  # unit; the light looks along +z
    ahead: Tensor  # their z, kept away from 0
    uv: Vec2  # in the unit square; the middle where `inside` is False
    inside: Tensor  # bool: they meet the image

    @staticmethod
    def of(to_local: Frame, to_uv: Vec2, d: Vec3) -> Screen:
        """Projects world directions `d` to the light's image; `to_uv`: factors from x / z and y / z to uv."""
        local = direction_to_local(to_local, d)
        ahead = local.z.clamp_min(FLATTEST)
        uv = Vec2(0.5 + to_uv.x * local.x / ahead, 0.5 + to_uv.y * local.y / ahead)
        inside = (local.z > FLATTEST) & (uv.x >= 0) & (uv.x <= 1) & (uv.y >= 0) & (uv.y <= 1)
        return Screen(local, ahead, uv.map(lambda c: torch.where(inside, c, 0.5)), inside)


    @staticmethod
    def towards(to_local: Frame, to_uv: Vec2, uv: Vec2) -> Vec3:
        """The world directions, of any length, of positions in the light's image."""
        x, y = (uv.x - 0.5) / to_uv.x, (uv.y - 0.5) / to_uv.y
        return direction_from_local(to_local, Vec3(x, y, torch.ones_like(x)))


def direction_from_local(to_local: Frame, local: Vec3) -> Vec3:
    """World directions, of any length, of a light's local ones."""
    s, t, n = to_local
    upright = cross(s, t)
    return (cross(t, n) * local.x + cross(n, s) * local.y + upright * local.z) / dot(upright, n)


def local_solid_angle(to_local: Frame, d: Vec3) -> Tensor:
    """The solid angle of a light's local directions per solid angle in the world, at unit world directions."""
    local = to_local.to_local(d)
    length = torch.sqrt(dot(local, local).clamp_min(NEAREST**2))
    return dot(cross(to_local.s, to_local.t), to_local.n).abs() / (length * length * length)


def direction_to_local(to_local: Frame, d: Vec3) -> Vec3:
    """World directions in a light's local coordinates, unit length whatever its scale."""
    local = to_local.to_local(d)
    return local * torch.rsqrt(dot(local, local).clamp_min(NEAREST**2))


def axes(to_world: Tensor) -> Frame:
    """The rows of the matrix from world directions to those of a light, () each, for `Frame.to_local`."""
    return Frame(*(Vec3.of(row) for row in linear_inverse(to_world).unbind()))


def at(place: Tensor, axis: Vec3 | None = None) -> ShadowSource:
    """The shadow source of a light at a point (3,) that shines around an axis, or into every direction."""
    place = place.detach()
    return ShadowSource(torch.cat([place, place.new_ones(1)]),
                        place.new_zeros(3) if axis is None else torch.stack(tuple(axis)).detach())
