"""A texture whose values are attributes of a mesh."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import torch
from torch import Tensor

from torch_radbp.interface.texture import LUMINANCE, TableReader, TexturePoint
from torch_radbp.plugin import Texture, finite, register
from torch_radbp.plugin.domain import NUMBER, Domain
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.vec import Vec2, Vec3

PREFIXES = ("vertex_", "face_")


@dataclass(frozen=True)
class MeshAttributeReader(TableReader):
    """Interpolates the attribute `name` of whatever mesh a ray hits. Bank: (X,) factors."""

    name: str
    as_number: bool = False  # the luminance of three channels
    needs_uv: ClassVar[bool] = False

    @property
    def attributes(self) -> tuple[str, ...]:
        return (self.name,)

    def of_numbers(self) -> MeshAttributeReader:
        return replace(self, as_number=True)

    def bank(self, textures: Sequence[Texture], dtype: torch.dtype, device: torch.device) -> Vec3:
        return Vec3.of(torch.stack([texture.texels().reshape(3) for texture in textures]).to(dtype=dtype, device=device))

    def read(self, bank: Vec3, row: Tensor, point: TexturePoint) -> Vec3:
        value = point.attributes[self.name]
        if self.as_number:
            number = luminance(value)
            value = Vec3(number, number, number)
        return value * lookup(bank, row)

    def rise(self, bank: Vec3, row: Tensor, point: TexturePoint) -> Vec2:
        factor, changes = lookup(bank.x, row), point.edges.attributes[self.name]
        return Vec2(*((luminance(change) if self.as_number else change.x) * factor for change in changes))


def luminance(colour: Vec3) -> Tensor:
    """The luminance of a linear colour."""
    return colour.x * LUMINANCE[0] + colour.y * LUMINANCE[1] + colour.z * LUMINANCE[2]


@register("texture", "mesh_attribute")
class MeshAttribute(Texture):
    """Attributes of the vertices or faces of the mesh with this material or emitter, such as measured colours.

    Those of vertices are interpolated linearly. A PLY file brings attributes along, and `Mesh.add_attribute` adds others;
    they are parameters of the mesh. Of three channels where a number is asked for, it is the luminance.

    Parameters: `scale`, (). Derivatives: with respect to the scale, and to the attribute of the mesh.

    Args:
        name: of the attribute, which begins with vertex_ or face_.
        scale: a factor.

    Raises:
        ValueError: if the name begins with something else.
    """

    def __init__(self, *, name: str, scale: float = 1.0):
        super().__init__()
        if not name.startswith(PREFIXES):
            raise ValueError(f"name must begin with {' or '.join(PREFIXES)}, got {name!r}")
        self.name = name
        self.freeze("scale", finite("scale", scale, ()).to(torch.get_default_dtype()))

    def domains(self) -> dict[str, Domain]:
        return {"scale": NUMBER}

    def check(self, name: str, domain: Domain) -> None:
        """Does nothing: mesh attributes are checked by `torch_radbp.scene.packing.attributes`."""

    def sources(self) -> tuple[Tensor, ...]:
        return (self.scale,)

    def reader(self) -> MeshAttributeReader:
        """The object that interpolates mesh attributes for lanes."""
        return MeshAttributeReader(self.name)

    def texels(self) -> Tensor:
        """(1, 1, 3) the factor `scale`, attached."""
        return self.scale.expand(1, 1, 3)

    def scalars(self) -> Tensor:
        """(1, 1) the factor `scale`, attached."""
        return self.scale.reshape(1, 1)
