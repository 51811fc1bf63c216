"""A projector: a point that projects an image."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import torch
from torch import Tensor

from torch_radbp.emitter.attributes import FACTOR, Scaled, factor, weight
from torch_radbp.emitter.positional import PositionalKind, Screen, at, axes, direction_to_local, local_solid_angle
from torch_radbp.interface.emitter import Light, ShadowSource
from torch_radbp.interface.emitter_bounds import LightBounds
from torch_radbp.plugin import Matrix4, Texture, register
from torch_radbp.plugin.domain import AMOUNT, POSE, Domain
from torch_radbp.plugin.jump_lines import JumpLines
from torch_radbp.sensor.perspective import field_of_view, horizontal_fov
from torch_radbp.tensors.vec import Frame, Vec2, Vec3, normalize
from torch_radbp.texture.rgb import as_texture
from torch_radbp.transforms import transform


class ProjectorTable(NamedTuple):
    """The table of projectors, a row for each; attached."""

    place: Vec3
    to_local: Frame  # rows of the matrix from world directions to the projector's, which shines along its +z
    to_uv: Vec2  # factors from x / z and y / z to texture coordinates


@dataclass(frozen=True)
class ProjectorKind(PositionalKind):
    """Projectors: intensity of a flat, evenly lit screen, 1 / cos^3 of the angle with the axis, within the image."""

    aimed: ClassVar[bool] = False

    def bounds(self, table: ProjectorTable, luminance: Tensor) -> LightBounds:
        place, axis = (v.map(lambda c: c.to(luminance)) for v in (table.place, normalize(table.to_local.n)))
        corner = torch.atan(0.5 * torch.hypot(1.0 / table.to_uv.x, 1.0 / table.to_uv.y)).to(luminance)
        return LightBounds(place, torch.zeros_like(luminance), luminance, axis, corner, torch.zeros_like(luminance))

    def beam(self, light: ProjectorTable, across: Vec2) -> tuple[Vec3, Tensor]:
        """Samples directions through uniform positions of the image, with their density over solid angle."""
        d = normalize(self.leaving(light, across))
        local = direction_to_local(light.to_local, d)
        area = (light.to_uv.x * light.to_uv.y).abs()  # of the image, for that of the plane at distance 1
        return d, area / (local.z * local.z * local.z) * local_solid_angle(light.to_local, d)

    def profile(self, light: ProjectorTable, d: Vec3) -> tuple[Tensor, Vec2]:
        _, ahead, uv, inside = Screen.of(light.to_local, light.to_uv, d)
        return inside.to(ahead.dtype) / (ahead * ahead * ahead), uv


@register("emitter", "projector")
class Projector(Light):
    """The reverse of a pinhole camera: projects an image along its local +z, as a camera there would see it.

    A screen at distance 1, perpendicular to the axis, receives pi times `scale` times `irradiance` on the axis, as in
    Mitsuba.

    Parameters: `to_world` (4, 4), `irradiance`, `scale` (). Derivatives: with respect to all. The light is discontinuous at
    the border of the image, and where that jumps: this counts where the camera sees it.

    Args:
        irradiance: the image; its resolution gives the aspect ratio (1 for a plain colour).
        scale: multiplies the image.
        to_world: its scale has no effect.
        fov: degrees, along `fov_axis`. Either this or `focal_length`.
        focal_length: such as "50mm", for 35 mm film.
        fov_axis: x, y, diagonal, smaller or larger.
    """

    def __init__(self, *, irradiance: Texture | float = 1.0, scale: float = 1.0, to_world: Matrix4 | None = None,
                 fov: float | None = None, focal_length: str | None = None, fov_axis: str = "x",
                 sampling_weight: float = 1.0):
        super().__init__()
        self.irradiance = as_texture(self, "irradiance", irradiance)
        fov, fov_axis = field_of_view(fov, focal_length, fov_axis)
        self.fov = float(fov) if fov_axis == "x" else horizontal_fov(fov, fov_axis, self.aspect())
        self.freeze("scale", factor(scale))
        self.freeze("to_world", transform("to_world", to_world))
        self.sampling_weight = weight(sampling_weight)

    fov_axis, focal_length = "x", None  # resolved into `fov`

    def domains(self) -> dict[str, Domain]:
        return {"to_world": POSE, "irradiance": AMOUNT, "scale": FACTOR}

    def picture_jumps(self) -> tuple[JumpLines, ...]:
        return self.irradiance.jumps()

    def picture_ends(self) -> bool:
        return True

    def aspect(self) -> float:
        """The aspect ratio of the image, width / height."""
        height, width = self.irradiance.resolution()
        return width / height

    def kind(self) -> ProjectorKind:
        return ProjectorKind()

    def radiated(self) -> Scaled:
        """The intensity along the axis, as a texture."""
        return Scaled(self.irradiance, self.scale * math.pi)

    def row(self) -> ProjectorTable:
        half = 0.5 / math.tan(math.radians(self.fov) / 2)
        to_uv: Tensor = self.to_world.new_tensor([-half, -half * self.aspect()])
        return ProjectorTable(Vec3.of(self.to_world[:3, 3]), axes(self.to_world), Vec2.of(to_uv))

    def source(self) -> ShadowSource:
        return at(self.to_world[:3, 3], axes(self.to_world).n)
