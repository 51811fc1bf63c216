"""Parallel light from far away."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_radbp.domain import AMOUNT, POSE, Domain
from torch_radbp.emitter.illumination import LightPose, colour
from torch_radbp.plugin import Emitter, Matrix4, Point3, Texture, finite, positive, register
from torch_radbp.pose import look_at
from torch_radbp.shape.surface import affine


@register("emitter", "directional")
class Directional(Emitter):
    """Shines along one direction, with `irradiance` (W / m^2) on a surface perpendicular to it.

    Parameters: `to_world` (4, 4), `irradiance`. Derivatives: with respect to both.

    Args:
        direction: in which the light travels, of any length; either this or `to_world`.
        to_world: its +z axis is that direction; scale and the other axes have no effect.
    """

    def __init__(self, *, direction: Point3 | None = None, to_world: Matrix4 | None = None,
                 irradiance: Texture | float = 1.0, sampling_weight: float = 1.0):
        super().__init__()
        if direction is not None and to_world is not None:
            raise ValueError("give either direction or to_world, not both")
        self.freeze("to_world", affine("to_world", to_world if direction is None else facing(direction)))
        self.irradiance = colour(self, "irradiance", irradiance)
        self.sampling_weight = positive("sampling_weight", sampling_weight)

    direction = None  # resolved into `to_world`

    def domains(self) -> dict[str, Domain]:
        return {"to_world": POSE, "irradiance": AMOUNT}

    def radiated(self) -> Texture:
        """The texture of the emitted light."""
        return self.irradiance

    def pose(self) -> LightPose:
        return LightPose.at(-torch.nn.functional.normalize(self.to_world[:3, 2], dim=0))


def facing(direction: Tensor) -> Tensor:
    """(4, 4) rotation whose +z points along `direction`, its other axes as Mitsuba's.

    Raises:
        ValueError: if the direction is zero.
    """
    direction = finite("direction", direction, (3,)).double()
    if not direction.any():
        raise ValueError("direction must not be zero")
    return look_at(torch.zeros_like(direction), direction)
