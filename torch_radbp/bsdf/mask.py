"""A material with holes: an opacity mask."""

from __future__ import annotations

from dataclasses import dataclass

from torch_radbp.bsdf.blendbsdf import BlendKind, is_still
from torch_radbp.bsdf.null import NullKind
from torch_radbp.bsdf.number import NumberOf
from torch_radbp.interface.bsdf import Kind, Values
from torch_radbp.plugin import BSDF, Texture, register
from torch_radbp.plugin.domain import FRACTION, Domain
from torch_radbp.tensors.vec import Vec3
from torch_radbp.texture.rgb import as_texture


@dataclass(frozen=True)
class MaskKind(BlendKind):
    """An opacity mask: a blend whose first BSDF is `null`, so that holes have no colour."""

    def diffuse_reflectance(self, values: Values, wi: Vec3) -> Vec3:
        return self.second.diffuse_reflectance(self.parts(values)[1], wi)


@register("bsdf", "mask")
class Mask(BSDF):
    """A material that lets a part of the light pass straight through: a blend with `null`.

    Parameters: `opacity`, a texture in [0, 1]. Derivatives: with respect to the texels of the opacity, and to the parameters
    of the material; right where the opacity is 0 or 1, too, see `blendbsdf`. Where surfaces move, lines at which the opacity
    jumps count where the camera sees them; paths that meet the mask later are glued to it, so that there edges count that
    are seen through its holes. Next-event estimation finds light behind in scenes with media alone: see `null`. Mitsuba
    3.9.1's `path` loses direct light on masks where paths end in them, or leave the scene through them and nothing surrounds
    it (`tests/bsdf/test_closed_mask.py`).

    Args:
        nested_bsdf: the material.
        opacity: in [0, 1]; 0 lets all light pass, 1 none. Of a constant colour the mean is used, of a colour bitmap the
            luminance.

    Raises:
        ValueError: if an opacity is out of range.
    """

    def __init__(self, *, nested_bsdf: BSDF, opacity: Texture | float = 0.5):
        super().__init__()
        self.opacity = as_texture(self, "opacity", opacity)
        self.opacity_number = (NumberOf(self, "opacity"),)  # a tuple, so that it is no submodule
        self.nested_bsdf = nested_bsdf

    def domains(self) -> dict[str, Domain]:
        return {"opacity": FRACTION}

    def kind(self) -> Kind:
        """The functions that evaluate and sample this BSDF."""
        return MaskKind(NullKind(), self.nested_bsdf.kind(), is_still(self.opacity))

    def textures(self) -> tuple[Texture, ...]:
        """The textures of this BSDF's parameters, in the order in which its functions take them."""
        return *self.opacity_number, *self.nested_bsdf.textures()
