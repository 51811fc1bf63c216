"""The same light from every direction."""

from __future__ import annotations

from torch_radbp.plugin import Emitter, Texture, positive, register
from torch_radbp.texture.rgb import RGB, as_texture, check_range


@register("emitter", "constant")
class Constant(Emitter):
    """An endlessly distant surround of constant `radiance`.

    Parameters: `radiance`. Derivatives: with respect to its value.
    """

    def __init__(self, *, radiance: Texture | float = 1.0, sampling_weight: float = 1.0):
        super().__init__()
        self.radiance = check_range("radiance", as_texture("radiance", radiance))
        if not isinstance(self.radiance, RGB):
            raise ValueError(f"radiance of a constant emitter must be one number or an rgb, got a {self.radiance.type}")
        self.sampling_weight = positive("sampling_weight", sampling_weight)
