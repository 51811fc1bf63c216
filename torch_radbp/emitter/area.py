"""A surface that emits light."""

from __future__ import annotations

from torch_radbp.domain import AMOUNT, Domain
from torch_radbp.plugin import Emitter, Texture, positive, register
from torch_radbp.texture.rgb import as_texture


@register("emitter", "area")
class Area(Emitter):
    """Emits `radiance` (W / (m^2 sr)) from the front side of the shape that carries it.

    Parameters: `radiance`, a texture. Derivatives: with respect to its texels.
    """

    def __init__(self, *, radiance: Texture | float = 1.0, sampling_weight: float = 1.0):
        super().__init__()
        self.radiance = as_texture(self, "radiance", radiance)
        self.sampling_weight = positive("sampling_weight", sampling_weight)

    def domains(self) -> dict[str, Domain]:
        return {"radiance": AMOUNT}
