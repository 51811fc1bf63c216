"""A volume as the texture of a surface."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import torch
from torch import Tensor

from torch_radbp.interface.texture import TableReader, TexturePoint, luminance_weights
from torch_radbp.interface.volume import VolumeKind
from torch_radbp.plugin import Texture, Volume, register
from torch_radbp.plugin.domain import Domain
from torch_radbp.tensors.vec import Vec2, Vec3, dot, where
from torch_radbp.texture.mesh_attribute import luminance
from torch_radbp.volume.constvolume import as_volume


@dataclass(frozen=True)
class VolumeReader(TableReader):
    """Reads volumes of one kind at points of surfaces, as textures; `bank` holds the tables of the volumes."""

    volume: VolumeKind
    as_number: bool = False  # the luminance of three channels
    needs_uv: ClassVar[bool] = False
    needs_position: ClassVar[bool] = True

    def of_numbers(self) -> VolumeReader:
        return replace(self, as_number=True)

    def bank(self, textures: Sequence[Texture], dtype: torch.dtype, device: torch.device) -> tuple[Any, ...]:
        return tuple(texture.volume.table(dtype, device) for texture in textures)

    def read(self, bank: tuple[Any, ...], row: Tensor, point: TexturePoint) -> Vec3:
        assert point.p is not None
        value = self.volume.eval(bank[0], point.p)
        for number, table in enumerate(bank[1:], 1):
            value = where(row == number, self.volume.eval(table, point.p), value)
        if self.as_number:
            grey = luminance(value)
            value = Vec3(grey, grey, grey)
        return value

    def rise(self, bank: tuple[Any, ...], row: Tensor, point: TexturePoint) -> Vec2:
        assert point.p is not None and point.edges is not None
        slope = self.slope(bank[0], point.p)
        for number, table in enumerate(bank[1:], 1):
            slope = where(row == number, self.slope(table, point.p), slope)
        return Vec2(*(dot(slope, edge) for edge in point.edges.p))

    def slope(self, table: Any, p: Vec3) -> Vec3:
        """The derivative of the texture's scalar, or of its first channel, by the point."""
        slopes = self.volume.slopes(table, p)
        return slopes[0] if len(slopes) == 1 or not self.as_number else Vec3(*map(luminance, map(Vec3._make, zip(*slopes))))


@register("texture", "volume")
class VolumeTexture(Texture):
    """A volume where the surface is: its values are read at the point in the world, and need no surface coordinates.

    Parameters: those of the volume, such as `volume.data`. Derivatives: with respect to them, and through the point to
    whatever moves the surface, but for the jumps of a `gridvolume` whose filter is nearest. It stands in materials, not in
    emitters; in Mitsuba not in a `bumpmap`, a `plastic` or a `roughplastic`, either.

    Args:
        volume: one of one channel or three, such as a `gridvolume`; or a colour.
    """

    on_lights = False

    def __init__(self, *, volume: Volume | Texture | float = 0.75):
        super().__init__()
        self.volume = as_volume(self, "volume", volume)

    def domains(self) -> dict[str, Domain]:
        return {"volume": Domain()}

    def reader(self) -> VolumeReader:
        """The object that reads volumes for lanes."""
        return VolumeReader(self.volume.kind())

    def texels(self) -> Tensor:
        """The entries of the volume in one row, (1, K, 3), attached."""
        entries = self.volume.samples()
        return entries.reshape(1, -1, entries.shape[-1]).expand(-1, -1, 3)

    def scalars(self) -> Tensor:
        """The luminance of the entries, (1, K), attached."""
        texels = self.texels()
        return (texels * luminance_weights(texels.dtype, texels.device)).sum(2)
