"""The same value everywhere."""

from __future__ import annotations

from torch_radbp.plugin import Plugin, Texture, Volume, register
from torch_radbp.plugin.domain import AMOUNT, Domain
from torch_radbp.tensors.vec import Vec3
from torch_radbp.texture.rgb import as_texture


@register("volume", "constvolume")
class ConstVolume(Volume):
    """A value that is the same everywhere.

    Parameters: `value`, a colour. Derivatives: with respect to it.

    Args:
        value: one number, or three.
    """

    def __init__(self, *, value: Texture | float = 1.0):
        super().__init__()
        self.value = as_texture(self, "value", value)
        if self.value.resolution() != (1, 1):
            raise ValueError(f"value of constvolume must be a colour or a number, got a {self.value.type}")

    def domains(self) -> dict[str, Domain]:
        return {"value": AMOUNT._replace(floor=0.0)}

    def colour(self) -> Vec3:
        """The value, () for each channel, attached."""
        return Vec3.of(self.value.texels()[0, 0])


def as_volume(owner: Plugin, name: str, value: Volume | Texture | float) -> Volume:
    """Makes the volume for the attribute `name` of a medium, from a volume, or anything that a colour is made of.

    Raises:
        ValueError: if a value is not in the attribute's domain.
    """
    volume = value if isinstance(value, Volume) else ConstVolume(value=value)
    volume.value.check(name, owner.domains()[name])
    return volume
