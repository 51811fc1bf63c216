"""A material whose shading normals are given by a normal map."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import torch

from torch_radbp.bsdf.turned import TurnedKind
from torch_radbp.interface.bsdf import Kind, Values
from torch_radbp.plugin import BSDF, Texture, boolean, register
from torch_radbp.plugin.domain import Domain
from torch_radbp.tensors.vec import Vec3
from torch_radbp.texture.bitmap import Bitmap
from torch_radbp.texture.rgb import as_texture


@dataclass(frozen=True)
class NormalMapKind(TurnedKind):
    """A normal-mapped BSDF. Parameter values: the normal as a colour (n + 1) / 2, those of the nested BSDF."""

    normal_values: ClassVar[int] = 1

    def normal(self, values: Values) -> Vec3:
        one = torch.ones_like(values[0].x)
        return values[0] * 2.0 - Vec3(one, one, one)


@register("bsdf", "normalmap")
class NormalMap(BSDF):
    """A material seen as if the surface had other normals, which an image gives relative to the shading frame.

    Parameters: `normalmap`, a texture. Derivatives: with respect to the texels of the normals, and to the parameters of the
    material. What is discontinuous in the normal (see `torch_radbp.bsdf.turned`) has no derivative where it jumps.

    Args:
        normalmap: the normal n as a colour (n + 1) / 2, of any length: (0.5, 0.5, 1) turns nothing. Read with `raw`, or sRGB
            is decoded that was never encoded. x points to where the coordinate u grows.
        nested_bsdf: the material.
        flip_invalid_normals: turn normals round that face away from the viewer.
        use_shadowing_function: let light fade towards the horizon of the surface.
    """

    def __init__(self, *, normalmap: Texture, nested_bsdf: BSDF, flip_invalid_normals: bool = True,
                 use_shadowing_function: bool = True):
        super().__init__()
        self.normalmap = as_texture(self, "normalmap", normalmap)
        if isinstance(self.normalmap, Bitmap) and self.normalmap.channels == 1:
            which = self.normalmap.filename or "the bitmap"
            raise ValueError(f"normalmap must have three channels, the components of the normal; {which} has one: heights "
                             "belong into a bumpmap")
        self.nested_bsdf = nested_bsdf
        self.flip_invalid_normals = boolean("flip_invalid_normals", flip_invalid_normals)
        self.use_shadowing_function = boolean("use_shadowing_function", use_shadowing_function)

    def domains(self) -> dict[str, Domain]:
        return {"normalmap": Domain(limit=1e6)}

    def kind(self) -> Kind:
        """The functions that evaluate and sample this BSDF."""
        return NormalMapKind(self.nested_bsdf.kind(), self.flip_invalid_normals, self.use_shadowing_function)

    def textures(self) -> tuple[Texture, ...]:
        """The textures of this BSDF's parameters, in the order in which its functions take them."""
        return self.normalmap, *self.nested_bsdf.textures()
