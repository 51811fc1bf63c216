"""What the emitters on surfaces have in common."""

from __future__ import annotations

from torch_radbp.emitter.attributes import weight
from torch_radbp.interface.emitter import Light
from torch_radbp.plugin import Texture
from torch_radbp.plugin.domain import AMOUNT, Domain
from torch_radbp.texture.rgb import as_texture


class SurfaceLight(Light):
    """Emits `radiance`, a texture or a module, from the shape that carries it; its kind says where to and in which unit.

    Args:
        radiance: of the light; `area`: W / (m^2 sr), `directionalarea`: W / m^2.
    """

    takes_modules = True

    def __init__(self, *, radiance: Texture | float = 1.0, sampling_weight: float = 1.0):
        super().__init__()
        self.radiance = as_texture(self, "radiance", radiance)
        self.sampling_weight = weight(sampling_weight)

    def domains(self) -> dict[str, Domain]:
        return {"radiance": AMOUNT}

    def radiated(self) -> Texture:
        return self.radiance
