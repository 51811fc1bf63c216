"""The same value everywhere."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import torch
from torch import Tensor

from torch_radbp.interface.volume import VolumeFunction, VolumeKind
from torch_radbp.plugin import Matrix4, Plugin, Texture, Volume, register
from torch_radbp.plugin.domain import AMOUNT, Domain
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.vec import Vec3
from torch_radbp.texture.rgb import as_texture
from torch_radbp.transforms import affine, transform_points


@dataclass(frozen=True)
class ConstKind(VolumeKind):
    """A volume that has one value everywhere."""

    def values(self, table: tuple[Tensor, ...], p: Vec3) -> tuple[Tensor, ...]:
        return lookup(table, torch.zeros_like(p.x, dtype=torch.int32))

    def slopes(self, table: tuple[Tensor, ...], p: Vec3) -> tuple[Vec3, ...]:
        return (Vec3.full(p.x, 0.0),) * len(table)


@register("volume", "constvolume")
class ConstVolume(VolumeFunction):
    """A value that is the same everywhere.

    Parameters: `value`, a colour. Derivatives: with respect to it.

    Args:
        value: one number, or three.
        to_world: the pose of the unit cube that a heterogeneous medium of this extinction fills.
    """

    def __init__(self, *, value: Texture | float = 1.0, to_world: Matrix4 | None = None):
        super().__init__()
        self.register_buffer("to_world", affine("to_world", to_world).to(torch.get_default_dtype()))
        self.value = as_texture(self, "value", value)
        if self.value.resolution() != (1, 1):
            raise ValueError(f"value of constvolume must be a colour or a number, got a {self.value.type}")

    def domains(self) -> dict[str, Domain]:
        return {"value": AMOUNT._replace(floor=0.0)}

    def kind(self) -> ConstKind:
        return ConstKind()

    def table(self, dtype: torch.dtype | None = None, device: torch.device | None = None) -> tuple[Tensor, ...]:
        return tuple(self.value.texels().to(dtype=dtype, device=device).reshape(3, 1).contiguous().unbind())

    def channels(self) -> int:
        return 3

    def entries(self) -> dict[str, Tensor]:
        return {"value": self.value.texels()}

    def corners(self) -> Tensor:
        unit = torch.tensor(list(product((0.0, 1.0), repeat=3)), dtype=self.to_world.dtype, device=self.to_world.device)
        return transform_points(self.to_world, unit)

    def colour(self) -> Vec3:
        """The volume's value, () for each channel, attached."""
        return Vec3.of(self.value.texels()[0, 0])


def as_volume(owner: Plugin, name: str, value: Volume | Texture | float, channels: tuple[int, ...] = (1, 3)) -> Volume:
    """Makes the volume for the attribute `name` of a plugin, from a volume, or anything that a colour is made of.

    Raises:
        ValueError: if a value is not in the attribute's domain, or there are other numbers of channels.
    """
    volume = value if isinstance(value, Volume) else ConstVolume(value=as_texture(owner, name, value))
    if volume.channels() not in channels:
        raise ValueError(f"{name} of {owner.type} must have {' or '.join(map(str, channels))} channels, got a {volume.type} "
                         f"of {volume.channels()}")
    for values in volume.entries().values():
        owner.domains()[name].check(name, values)
    return volume


def as_constant(owner: Plugin, name: str, value: Volume | Texture | float) -> ConstVolume:
    """Makes the constant volume for the attribute `name` of a plugin; raises ValueError if the value varies in space."""
    volume = as_volume(owner, name, value)
    if not isinstance(volume, ConstVolume):
        raise ValueError(f"{name} of {owner.type} must be the same everywhere, got a {volume.type}")
    return volume
