"""The same light from every direction."""

from __future__ import annotations

from torch_radbp.domain import AMOUNT, Domain
from torch_radbp.emitter.illumination import colour
from torch_radbp.plugin import Emitter, Texture, positive, register


@register("emitter", "constant")
class Constant(Emitter):
    """An infinitely distant surround of constant `radiance`.

    Parameters: `radiance`. Derivatives: with respect to its value.
    """

    def __init__(self, *, radiance: Texture | float = 1.0, sampling_weight: float = 1.0):
        super().__init__()
        self.radiance = colour(self, "radiance", radiance)
        self.sampling_weight = positive("sampling_weight", sampling_weight)

    def domains(self) -> dict[str, Domain]:
        return {"radiance": AMOUNT}

    def radiated(self) -> Texture:
        """The texture of the emitted light."""
        return self.radiance
