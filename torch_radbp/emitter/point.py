"""A point that emits light."""

from __future__ import annotations

import torch

from torch_radbp.domain import AMOUNT, POINT, Domain
from torch_radbp.emitter.illumination import LightPose, colour
from torch_radbp.plugin import Emitter, Matrix4, Point3, Texture, finite, positive, register
from torch_radbp.shape.surface import affine, transform_points


@register("emitter", "point")
class Point(Emitter):
    """Emits `intensity` (W / sr) from `position` into every direction.

    Parameters: `position` (3,), `intensity`. Derivatives: with respect to both.

    Args:
        position: world coordinates; either this or the translation of `to_world`.
    """

    def __init__(self, *, position: Point3 | None = None, to_world: Matrix4 | None = None,
                 intensity: Texture | float = 1.0, sampling_weight: float = 1.0):
        super().__init__()
        if position is not None and to_world is not None:
            raise ValueError("give either position or to_world, not both")
        origin = torch.zeros(1, 3, dtype=torch.get_default_dtype())
        place = None if position is None else finite("position", position, (3,)).to(origin.dtype)
        self.freeze("position", transform_points(affine("to_world", to_world), origin)[0] if place is None else place)
        self.intensity = colour(self, "intensity", intensity)
        self.sampling_weight = positive("sampling_weight", sampling_weight)

    to_world = None  # resolved into `position`

    def domains(self) -> dict[str, Domain]:
        return {"position": POINT, "intensity": AMOUNT}

    def radiated(self) -> Texture:
        """The texture of the emitted light."""
        return self.intensity

    def pose(self) -> LightPose:
        return LightPose.at(self.position)
