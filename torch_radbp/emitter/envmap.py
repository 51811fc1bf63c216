"""Light from an image of the surroundings."""

from __future__ import annotations

from torch import Tensor

from torch_radbp.domain import AMOUNT, POSE, Domain
from torch_radbp.emitter.illumination import FACTOR, factor
from torch_radbp.plugin import Emitter, Filename, Matrix4, positive, register
from torch_radbp.shape.surface import affine
from torch_radbp.texture.bitmap import IMAGE, linear_image


@register("emitter", "envmap")
class Envmap(Emitter):
    """An infinitely distant surround: an image by latitude and longitude.

    The first row lies at the local +y pole, the last at -y, and the image is interpolated between the centres of its
    columns, also across the seam, as in Mitsuba (which first enlarges images of fewer than 3 rows or 2 columns; here they
    are read as they are). With a `to_world` that is not rigid, directions are normalised after the transform.

    Parameters: `data` (H, W, 3) linear RGB, `scale` (), `to_world` (4, 4). Derivatives: with respect to all.

    Args:
        filename: EXR, PNG or JPEG. Either this or `bitmap`.
        bitmap, data: (H, W), (H, W, 1) or (H, W, 3) linear values; both names mean the same.
        scale: multiplies the image.
        mis_compensation: sample only texels brighter than the average, and leave the rest to BSDF sampling (Karlik et al.
            2019).
    """

    has_coordinates = False  # read by direction

    def __init__(self, *, filename: Filename | None = None, bitmap: Tensor | None = None, data: Tensor | None = None,
                 scale: float = 1.0, to_world: Matrix4 | None = None, mis_compensation: bool = False,
                 sampling_weight: float = 1.0):
        super().__init__()
        image = linear_image("an envmap", filename, {"bitmap": bitmap, "data": data})
        AMOUNT.check("data" if data is not None else "bitmap", image)
        self.filename, self.mis_compensation = filename, mis_compensation
        self.freeze("data", image)
        self.freeze("scale", factor(scale))
        self.freeze("to_world", affine("to_world", to_world))
        self.sampling_weight = positive("sampling_weight", sampling_weight)

    bitmap = None  # resolved into `data`

    def domains(self) -> dict[str, Domain]:
        return {"data": IMAGE._replace(low=0.0), "scale": FACTOR, "to_world": POSE}

    def texels(self) -> Tensor:
        """(H, W, 3) radiance, linear RGB, attached."""
        return self.data * self.scale

    def radiated(self) -> Envmap:
        """The texture of the emitted light."""
        return self
