"""Light from an image of the surroundings."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_radbp.emitter.illumination import FACTOR, factor
from torch_radbp.plugin import AMOUNT, POSE, Domain, Emitter, Filename, Matrix4, finite, positive, register
from torch_radbp.shape.surface import affine
from torch_radbp.texture.bitmap import IMAGE


@register("emitter", "envmap")
class Envmap(Emitter):
    """An endlessly distant surround, an image by latitude and longitude.

    The first row lies at the local +y pole, the last at -y, and the image is interpolated between the centres of its
    columns, around the seam, as in Mitsuba (which enlarges images of fewer than 3 rows or 2 columns first; here they are
    read as they are). Under a `to_world` that is not rigid, the direction is normalised after the transform.

    Parameters: `data` (H, W, 3) linear RGB, `scale` (), `to_world` (4, 4). Derivatives: with respect to all.

    Args:
        filename: EXR, PNG or JPEG. Either this or `bitmap`.
        bitmap: (H, W), (H, W, 1) or (H, W, 3) linear values.
        scale: multiplies the image.
        mis_compensation: sample only what is brighter than the average, and leave the rest to BSDF sampling
            (Karlik et al. 2019).
    """

    has_coordinates = False  # is read by direction

    def __init__(self, *, filename: Filename | None = None, bitmap: Tensor | None = None, scale: float = 1.0,
                 to_world: Matrix4 | None = None, mis_compensation: bool = False, sampling_weight: float = 1.0):
        super().__init__()
        if (filename is None) == (bitmap is None):
            raise ValueError("an envmap needs either filename or bitmap, and not both")
        if bitmap is None:
            from torch_radbp.io.image import read_image  # io reads files for every layer above `vec`

            bitmap = read_image(filename)
        data = finite("bitmap", bitmap).to(torch.get_default_dtype())
        data = data[..., None] if data.ndim == 2 else data
        if data.ndim != 3 or data.shape[2] not in (1, 3) or data.numel() == 0:
            raise ValueError(f"bitmap must have shape (H, W), (H, W, 1) or (H, W, 3), got {tuple(data.shape)}")
        AMOUNT.check("bitmap", data)
        self.filename, self.mis_compensation = filename, mis_compensation
        self.freeze("data", data.expand(-1, -1, 3).contiguous())
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
        """The texture that tells how much light there is."""
        return self
