"""A spotlight: a point that emits a cone of light."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torch_radbp.emitter.attributes import Scaled, colour, weight
from torch_radbp.emitter.positional import (
    PositionalKind,
    Screen,
    at,
    axes,
    direction_from_local,
    direction_to_local,
    local_solid_angle,
)
from torch_radbp.interface.emitter import NEAREST, Light, ShadowSource
from torch_radbp.interface.emitter_bounds import LightBounds
from torch_radbp.plugin import Matrix4, Texture, register, warn_of_radians
from torch_radbp.plugin.domain import AMOUNT, NUMBER, POSE, Domain
from torch_radbp.plugin.jump_lines import JumpLines
from torch_radbp.tensors.vec import Frame, Vec2, Vec3, normalize
from torch_radbp.texture.rgb import as_texture
from torch_radbp.transforms import transform

ROUNDING = 1e-4  # by which the beam of a file may be wider than its cone
NARROWEST = 1e-3  # fall-off of a light that ends sharply in a file, over its cutoff
CUTOFF = NUMBER._replace(low=0.0, high=180.0, low_is_in=False, unit=" degrees")


class SpotTable(NamedTuple):
    """The table of spotlights, a row for each; attached."""

    place: Vec3
    to_local: Frame  # rows of the matrix from world directions to the spot's, which shines along its +z
    cutoff: Tensor  # angle where it ends, radians
    sharpness: Tensor  # 1 / width of the fall-off before the cutoff, 1 / radians
    to_uv: Vec2 | None  # factors from x / z and y / z to texture coordinates; None: no spot has an image


@dataclass(frozen=True)
class SpotKind(PositionalKind):
    """Spotlights: intensity falls off linearly with the angle from the axis."""

    def table(self, emitters: Sequence[Spot], like: Tensor) -> SpotTable:
        table = super().table(emitters, like)
        return table if any(emitter.texture is not None for emitter in emitters) else table._replace(to_uv=None)

    def bounds(self, table: SpotTable, luminance: Tensor) -> LightBounds:
        place, axis = (v.map(lambda c: c.to(luminance)) for v in (table.place, normalize(table.to_local.n)))
        cutoff, width = table.cutoff.to(luminance), 1.0 / table.sharpness.to(luminance)
        return LightBounds(place, torch.zeros_like(luminance), luminance, axis, cutoff - width, width)

    def beam(self, light: SpotTable, across: Vec2) -> tuple[Vec3, Tensor]:
        """Samples directions uniformly in the cone, with their density over solid angle."""
        size = 1.0 - torch.cos(light.cutoff)
        z = 1.0 - size * across.x
        r, phi = torch.sqrt((1.0 - z * z).clamp_min(0.0)), 2.0 * math.pi * across.y
        d = normalize(direction_from_local(light.to_local, Vec3(r * torch.cos(phi), r * torch.sin(phi), z)))
        return d, local_solid_angle(light.to_local, d) / (2.0 * math.pi * size)

    def profile(self, light: SpotTable, d: Vec3) -> tuple[Tensor, Vec2 | None]:
        if light.to_uv is None:
            local, uv = direction_to_local(light.to_local, d), None
        else:
            local, _, uv, _ = Screen.of(light.to_local, light.to_uv, d)
        sine = torch.sqrt((local.x * local.x + local.y * local.y).clamp_min(NEAREST**2))
        remaining = (light.cutoff - torch.atan2(sine, local.z)) * light.sharpness
        return remaining.clamp(0.0, 1.0), uv


@register("emitter", "spot")
class Spot(Light):
    """Emits `intensity` (W / sr) along its local +z, falling off linearly with the angle between beam width and cutoff.

    Parameters: `to_world` (4, 4), `intensity`, `cutoff_angle`, `beam_width` (), `texture`. Derivatives: with respect to all.

    Args:
        intensity: inside the beam.
        cutoff_angle: degrees from the axis at which the light ends.
        beam_width: degrees from the axis up to which it has its full strength; three quarters of the cutoff by default.
        texture: multiplies the intensity; covers the square around the cone, whose cutoff must be less than 90 degrees.
        to_world: its scale has no effect.
    """

    def __init__(self, *, intensity: Texture | float = 1.0, cutoff_angle: float = 20.0, beam_width: float | None = None,
                 texture: Texture | None = None, to_world: Matrix4 | None = None, sampling_weight: float = 1.0):
        super().__init__()
        self.add_module("texture", None)
        self.intensity = colour(self, "intensity", intensity)
        beam_width = 0.75 * cutoff_angle if beam_width is None else beam_width
        if not 0 < cutoff_angle <= 180:
            raise ValueError(f"cutoff_angle must be more than 0 and at most 180 degrees, got {cutoff_angle}")
        warn_of_radians("cutoff_angle", cutoff_angle)
        if not 0 <= beam_width < cutoff_angle:
            raise ValueError(f"beam_width must be at least 0 and less than the cutoff_angle of {cutoff_angle} degrees, got "
                             f"{beam_width}")
        if texture is not None and not cutoff_angle < 90:
            raise ValueError(f"cutoff_angle must be less than 90 degrees for a spot with a texture, got {cutoff_angle}")
        texture = None if texture is None else as_texture(self, "texture", texture)
        self.add_module("texture", texture)
        dtype = torch.get_default_dtype()
        self.freeze("cutoff_angle", torch.tensor(float(cutoff_angle), dtype=dtype))
        self.freeze("beam_width", torch.tensor(float(beam_width), dtype=dtype))
        self.freeze("to_world", transform("to_world", to_world))
        self.sampling_weight = weight(sampling_weight)

    @classmethod
    def of_file(cls, arguments: dict[str, Any], note: Callable[[str], None]) -> dict[str, Any]:
        """Repairs a beam as wide as the cone, by which exporters mean a sharp end, to the narrowest fall-off there is."""
        cutoff, beam = (arguments.get(name, default) for name, default in (("cutoff_angle", 20.0), ("beam_width", None)))
        if not isinstance(beam, float) or not isinstance(cutoff, float) or not cutoff <= beam <= cutoff * (1.0 + ROUNDING):
            return arguments
        note(f"beam_width, which is not less than cutoff_angle, is read as {1.0 - NARROWEST:g} times that: light that ended "
             "sharply would have no derivative")
        return {**arguments, "beam_width": cutoff * (1.0 - NARROWEST)}

    def domains(self) -> dict[str, Domain]:
        widest = CUTOFF if self.texture is None else CUTOFF._replace(high=90.0, high_is_in=False)
        return {"to_world": POSE, "intensity": AMOUNT, "texture": AMOUNT, "cutoff_angle": widest,
                "beam_width": NUMBER._replace(low=0.0, unit=" degrees")}

    def picture_jumps(self) -> tuple[JumpLines, ...]:
        return () if self.texture is None else self.texture.jumps()  # before the border of the image the beam ends

    def kind(self) -> SpotKind:
        return SpotKind()

    def radiated(self) -> Texture | Scaled:
        return self.intensity if self.texture is None else Scaled(self.texture, self.intensity.colour())

    def row(self) -> SpotTable:
        """The spotlight's row of the table: pose and cone, attached.

        Raises:
            ValueError: if an optimiser has moved the angles past each other, or flattened the pose.
        """
        cutoff, beam = torch.deg2rad(self.cutoff_angle), torch.deg2rad(self.beam_width)
        if not bool(self.beam_width < self.cutoff_angle):
            raise ValueError(f"beam_width must be less than cutoff_angle, got {float(self.beam_width)} and "
                             f"{float(self.cutoff_angle)} degrees")
        to_uv = self.to_world.new_zeros(2) if self.texture is None else (0.5 / torch.tan(cutoff)).expand(2)
        return SpotTable(Vec3.of(self.to_world[:3, 3]), axes(self.to_world), cutoff, 1.0 / (cutoff - beam), Vec2.of(to_uv))

    def source(self) -> ShadowSource:
        return at(self.to_world[:3, 3], axes(self.to_world).n)
