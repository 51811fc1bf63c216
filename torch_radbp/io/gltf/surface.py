"""Converts materials to glTF's metallic-roughness and its extensions, each kind by its own function.

| material | is written as | what differs |
|---|---|---|
| principled | itself | `spec_tint`, `flatness`; and see `extension` |
| diffuse | no metal, specularFactor 0 | nothing |
| conductor, roughconductor | metal of the reflectance from straight above | Schlick's Fresnel reflectance; Beckmann as GGX |
| plastic, roughplastic | no metal, ior | the diffuse base, light between it and the boundary |
| dielectric, roughdielectric | transmission of a solid body, ior | Beckmann as GGX |
| thindielectric, principledthin | transmission of a thin sheet | comes back as a solid body |
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import torch

from torch_radbp.bsdf.principled_lobes import index_by_specular
from torch_radbp.io.gltf.document import Losses
from torch_radbp.io.gltf.extension import roughness_of
from torch_radbp.io.gltf.image_slot import Slot, slot
from torch_radbp.plugin import BSDF

DEFAULT_IOR = 1.5
SOLID = {"thicknessFactor": 1.0}  # of KHR_materials_volume; any that is not 0


def constant_slot(value: float) -> Slot:
    """A slot of a material that holds one number everywhere: an image of one pixel."""
    return Slot(np.full((1, 1, 3), float(value)), None)


@dataclass
class GltfSurface:
    """A material in glTF's terms: metallic-roughness with extensions."""

    base: Slot = field(default_factory=lambda: constant_slot(1.0))
    colours: str | None = None  # attribute of vertices or faces that is the base colour
    roughness: Slot = field(default_factory=lambda: constant_slot(1.0))
    metallic: Slot = field(default_factory=lambda: constant_slot(0.0))
    transmission: Slot = field(default_factory=lambda: constant_slot(0.0))
    clearcoat: Slot = field(default_factory=lambda: constant_slot(0.0))
    extensions: dict[str, dict] = field(default_factory=dict)

    def set_ior(self, ior: float) -> None:
        if abs(ior - DEFAULT_IOR) > 1e-6:
            self.extensions["KHR_materials_ior"] = {"ior": ior}


class SurfaceTextures:
    """Reads the textures of one material as values for glTF.

    Args:
        bsdf: the material.
        name: of it.
        losses: filled in.
    """

    def __init__(self, bsdf: BSDF, name: str, losses: Losses):
        self.bsdf, self.name, self.losses = bsdf, name, losses

    def colour(self, attribute: str) -> Slot:
        """The values of a colour texture."""
        return slot(getattr(self.bsdf, attribute), f"{self.name}.{attribute}", self.losses)

    def number(self, attribute: str) -> Slot:
        """The values of a scalar texture."""
        return slot(getattr(self.bsdf, attribute), f"{self.name}.{attribute}", self.losses, as_number=True)

    def mean(self, attribute: str) -> float:
        """The mean of a scalar texture that glTF wants to be constant."""
        scalar = self.number(attribute)
        if not scalar.is_constant:
            self.losses.add(f"{self.name}.{attribute}", "is written as its mean")
        return scalar.number()

    def lose(self, what: str) -> None:
        self.losses.add(self.name, what)

    def base(self, surface: GltfSurface, attribute: str) -> None:
        """Sets the base colour from a texture, or from a mesh attribute."""
        texture = getattr(self.bsdf, attribute)
        if texture.type == "mesh_attribute":
            surface.colours, surface.base = texture.name, constant_slot(float(texture.scale.detach()))
        else:
            surface.base = self.colour(attribute)


def principled(read: SurfaceTextures) -> GltfSurface:
    surface, bsdf = GltfSurface(), read.bsdf
    read.base(surface, "base_color")
    surface.roughness, surface.metallic = read.number("roughness"), read.number("metallic")
    surface.transmission, surface.clearcoat = read.number("spec_trans"), read.number("clearcoat")
    surface.set_ior(float(index_by_specular(bsdf.specular.detach()) if bsdf.eta is None else bsdf.eta))
    if surface.transmission.values.any():
        surface.extensions["KHR_materials_volume"] = SOLID
    if surface.clearcoat.values.any():
        read.lose("clearcoat is four times as strong in glTF, and darkens what is below")
        roughness = roughness_of(read.mean("clearcoat_gloss"))
        surface.extensions["KHR_materials_clearcoat"] = {"clearcoatRoughnessFactor": roughness}
    stretched(surface, read)
    cloth(surface, read)
    for attribute in ("spec_tint", "flatness"):
        if read.number(attribute).values.any():
            read.lose(f"{attribute} is not written")
    return surface


def stretched(surface: GltfSurface, read: SurfaceTextures) -> None:
    """Converts `anisotropic` of a material to the extension KHR_materials_anisotropy; see `extension.anisotropy`."""
    anisotropic = read.mean("anisotropic")
    if anisotropic == 0:
        return
    if not surface.roughness.is_constant:
        read.lose("anisotropic is not written: glTF would have it change with the roughness, which is a texture")
        return
    aspect, alpha = math.sqrt(1.0 - 0.9 * anisotropic), surface.roughness.number() ** 2
    along_and_across(surface, alpha / aspect, alpha * aspect, 0.0)


def along_and_across(surface: GltfSurface, along: float, across: float, rotation: float) -> None:
    """Sets anisotropic roughness: `along` a direction, the greater one, and `across` it."""
    strength = math.sqrt(max(0.0, min(1.0, (along - across) / max(1.0 - across, 1e-6))))
    surface.roughness = constant_slot(math.sqrt(across))
    surface.extensions["KHR_materials_anisotropy"] = {"anisotropyStrength": strength,
                                                      **({"anisotropyRotation": rotation} if rotation else {})}


def cloth(surface: GltfSurface, read: SurfaceTextures) -> None:
    """Converts `sheen` and `sheen_tint` of a material to the extension KHR_materials_sheen."""
    sheen = read.mean("sheen")
    if sheen == 0:
        return
    read.lose("sheen has another curve in glTF")
    tint, colour = read.mean("sheen_tint"), surface.base.constant
    tinted = 1.0 + tint * (colour / max(float(colour.max()), 1e-6) - 1.0)
    surface.extensions["KHR_materials_sheen"] = {"sheenColorFactor": (sheen * tinted).tolist(), "sheenRoughnessFactor": 0.5}


def diffuse(read: SurfaceTextures) -> GltfSurface:
    surface = GltfSurface(extensions={"KHR_materials_specular": {"specularFactor": 0.0}})
    read.base(surface, "reflectance")
    return surface


def metal(read: SurfaceTextures) -> GltfSurface:
    """A metal, with its reflectance at normal incidence as base colour. Reference: Born and Wolf, section 14.2."""
    surface = GltfSurface(metallic=constant_slot(1.0), roughness=constant_slot(0.0))
    eta, k, factor = (read.colour(name) for name in ("eta", "k", "specular_reflectance"))
    textured = next((each for each in (factor, eta, k) if not each.is_constant), None)
    if any(not each.is_constant and (each.reading, each.values.shape) != (textured.reading, textured.values.shape)
           for each in (eta, k)):
        read.lose("eta and k are written as their means")
        eta, k = (Slot(each.constant.reshape(1, 1, 3), None) for each in (eta, k))
        textured = None if factor.is_constant else factor
    above = ((eta.values - 1) ** 2 + k.values**2) / ((eta.values + 1) ** 2 + k.values**2) * factor.values
    surface.base = Slot(above, None if textured is None else textured.reading)
    if (above != 1).any() or (eta.values != 0).any():  # else all light is reflected, from everywhere
        read.lose("its reflectance by angle is written as Schlick's")
    rough(surface, read)
    return surface


def rough(surface: GltfSurface, read: SurfaceTextures) -> None:
    """Sets the roughness from `alpha`, or `alpha_u` and `alpha_v`; without these it is 0."""
    bsdf = read.bsdf
    if getattr(bsdf, "distribution", "ggx") != "ggx":
        read.lose(f"its {bsdf.distribution} microfacets are written as ggx")
    if getattr(bsdf, "alpha", None) is not None:
        if isinstance(bsdf.alpha, torch.Tensor):
            surface.roughness = constant_slot(math.sqrt(min(1.0, float(bsdf.alpha))))
            return
        alpha = read.number("alpha")
        surface.roughness = Slot(np.sqrt(alpha.values.clip(0.0, 1.0)), alpha.reading)
    elif getattr(bsdf, "alpha_u", None) is not None:
        u, v = min(1.0, read.mean("alpha_u")), min(1.0, read.mean("alpha_v"))
        if u != v:
            along_and_across(surface, max(u, v), min(u, v), 0.0 if u > v else math.pi / 2)
        else:
            surface.roughness = constant_slot(math.sqrt(u))


def plastic(read: SurfaceTextures) -> GltfSurface:
    surface = GltfSurface(roughness=constant_slot(0.0))
    read.base(surface, "diffuse_reflectance")
    surface.set_ior(float(read.bsdf.eta))
    rough(surface, read)
    read.lose("light between the base and the boundary of a plastic is not written")
    return surface


def glass(read: SurfaceTextures) -> GltfSurface:
    surface = GltfSurface(roughness=constant_slot(0.0), transmission=constant_slot(1.0))
    eta = float(read.bsdf.eta)
    if eta < 1:
        read.lose(f"the index of refraction {eta:g} is written as {1 / eta:g}: glTF has none below 1")
    surface.set_ior(max(eta, 1 / eta))
    reflected, surface.base = read.colour("specular_reflectance"), read.colour("specular_transmittance")
    if (reflected.values != 1).any():
        read.lose("specular_reflectance is not written")
    surface.base = surface.base._replace(values=surface.base.values**2)  # its root is what passes, see `principled_lobes`
    if read.bsdf.type == "thindielectric":
        surface.base = read.colour("specular_transmittance")
    else:
        surface.extensions["KHR_materials_volume"] = SOLID
    rough(surface, read)
    return surface


def sheet(read: SurfaceTextures) -> GltfSurface:
    surface = GltfSurface()
    read.base(surface, "base_color")
    surface.roughness, surface.transmission = read.number("roughness"), read.number("spec_trans")
    surface.set_ior(read.mean("eta"))
    stretched(surface, read)
    cloth(surface, read)
    for attribute in ("spec_tint", "flatness", "diff_trans"):
        if read.number(attribute).values.any():
            read.lose(f"{attribute} is not written")
    return surface


KINDS: dict[str, Callable[[SurfaceTextures], GltfSurface]] = {
    "principled": principled, "principledthin": sheet, "diffuse": diffuse, "conductor": metal, "roughconductor": metal,
    "plastic": plastic, "roughplastic": plastic, "dielectric": glass, "roughdielectric": glass, "thindielectric": glass,
}


def surface_of(bsdf: BSDF, name: str, losses: Losses) -> GltfSurface:
    """Converts a material without nested ones to glTF's terms; to grey if glTF has no such kind."""
    if bsdf.type not in KINDS:
        losses.add(name, f"a {bsdf.type} has no counterpart in glTF, and is written as grey; those that have one: "
                         f"{', '.join(sorted(KINDS))}")
        return GltfSurface(base=constant_slot(0.5))
    return KINDS[bsdf.type](SurfaceTextures(bsdf, name, losses))
