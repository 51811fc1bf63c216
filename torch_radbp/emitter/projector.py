"""A point that projects an image."""

from __future__ import annotations

import math

from torch import Tensor

from torch_radbp.domain import AMOUNT, POSE, Domain
from torch_radbp.emitter.illumination import FACTOR, LightPose, Scaled, factor, linear_inverse
from torch_radbp.plugin import Emitter, Matrix4, Texture, positive, register
from torch_radbp.sensor.perspective import field_of_view, horizontal_fov
from torch_radbp.shape.surface import affine
from torch_radbp.texture.rgb import as_texture


@register("emitter", "projector")
class Projector(Emitter):
    """The reverse of a pinhole camera: projects an image along its local +z, as a camera there would see it.

    A screen at distance 1, perpendicular to the axis, receives pi times `scale` times `irradiance` on the axis, as in
    Mitsuba.

    Parameters: `to_world` (4, 4), `irradiance`, `scale` (). Derivatives: with respect to all, except for the contribution of
    the edge of the image, where the light is discontinuous.

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
        self.freeze("to_world", affine("to_world", to_world))
        self.sampling_weight = positive("sampling_weight", sampling_weight)

    fov_axis, focal_length = "x", None  # resolved into `fov`

    def domains(self) -> dict[str, Domain]:
        return {"to_world": POSE, "irradiance": AMOUNT, "scale": FACTOR}

    def aspect(self) -> float:
        """Width / height of the image."""
        height, width = self.irradiance.texels().shape[:2]
        return width / height

    def radiated(self) -> Scaled:
        """The texture of the emitted light: the intensity, as it would be along the axis."""
        return Scaled(self.irradiance, self.scale * math.pi)

    def pose(self) -> LightPose:
        half = 0.5 / math.tan(math.radians(self.fov) / 2)
        to_uv: Tensor = self.to_world.new_tensor([-half, -half * self.aspect()])
        return LightPose.at(self.to_world[:3, 3], linear_inverse("to_world", self.to_world), to_uv=to_uv)
