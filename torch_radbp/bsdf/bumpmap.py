"""A material whose shading normals follow from a height map (bump map)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import torch

from torch_radbp.bsdf.number import OwnNumber, SlopeOf
from torch_radbp.bsdf.turned import TurnedKind
from torch_radbp.interface.bsdf import Kind, Values
from torch_radbp.plugin import BSDF, Texture, boolean, finite, register
from torch_radbp.plugin.domain import NUMBER, Domain
from torch_radbp.tensors.vec import Vec3
from torch_radbp.texture.rgb import as_texture

LIMIT = 1e6  # of heights and of their scale: the squares of slopes are finite in float32


@dataclass(frozen=True)
class BumpMapKind(TurnedKind):
    """A bump-mapped BSDF. Parameter values: slope of the heights (see `barycentric_gradients.py`), scale (a scalar), those
    of the nested BSDF.
    """

    normal_values: ClassVar[int] = 2

    def normal(self, values: Values) -> Vec3:
        rise = values[0] * values[1].x
        one = torch.ones_like(rise.z)
        # The normal stays on the side of the triangle's own.
        side = 1.0 - 2.0 * (rise.z > 1.0).to(one.dtype)
        return Vec3(-rise.x * side, -rise.y * side, one * side)


@register("bsdf", "bumpmap")
class BumpMap(BSDF):
    """A material seen as if the surface were lifted along its normal, by heights that an image gives. Nothing is moved.

    Parameters: `nested_texture`, a texture; `scale`, a number. Derivatives: with respect to the heights, the scale and the
    parameters of the material. The slope of a bilinear image jumps at the centres of its texels; what is discontinuous
    besides (see `torch_radbp.bsdf.turned`) has no derivative where it jumps.

    Two things are right here that are not in Mitsuba 3.9.1: the slope of an image that is not square under a `to_uv` that
    turns it, and the direction of brushed materials on bumps, which follows u there as if the surface lay in the world's
    xy plane.

    Args:
        nested_texture: the heights in units of the scene, read with `raw`, or sRGB is decoded that was never encoded; under
            any name. Of a colour bitmap the luminance. Squares of a checkerboard, texels of a bitmap that is read by the
            nearest, attributes of faces and colours are level: their steps turn nothing.
        nested_bsdf: the material.
        scale: a factor on the heights.
        flip_invalid_normals: turn normals round that face away from the viewer.
        use_shadowing_function: let light fade towards the horizon of the surface.
    """

    object_of_any_name = "nested_texture"

    def __init__(self, *, nested_texture: Texture, nested_bsdf: BSDF, scale: float = 1.0, flip_invalid_normals: bool = True,
                 use_shadowing_function: bool = True):
        super().__init__()
        self.nested_texture = as_texture(self, "nested_texture", nested_texture)
        self.slope = (SlopeOf(self, "nested_texture"),)  # tuples, so that they are no submodules
        self.freeze("scale", finite("scale", scale, ()).to(torch.get_default_dtype()))
        self.scale_number = (OwnNumber(self, "scale"),)
        self.nested_bsdf = nested_bsdf
        self.flip_invalid_normals = boolean("flip_invalid_normals", flip_invalid_normals)
        self.use_shadowing_function = boolean("use_shadowing_function", use_shadowing_function)

    def domains(self) -> dict[str, Domain]:
        return {"nested_texture": Domain(limit=LIMIT), "scale": NUMBER._replace(limit=LIMIT)}

    def kind(self) -> Kind:
        """The functions that evaluate and sample this BSDF."""
        return BumpMapKind(self.nested_bsdf.kind(), self.flip_invalid_normals, self.use_shadowing_function)

    def textures(self) -> tuple[Texture, ...]:
        """The textures of this BSDF's parameters, in the order in which its functions take them."""
        return *self.slope, *self.scale_number, *self.nested_bsdf.textures()
