"""Reads glTF materials: metallic-roughness as `principled`, nested in normal map, two-sided and mask as needed.

A material called gold becomes `gold`, a `principled` (or `diffuse`), and as far as it asks for them, each around the one
before: `gold_normalmap`, `gold_twosided`, `gold_mask`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor

from torch_radbp.bsdf.diffuse import Diffuse
from torch_radbp.bsdf.mask import Mask
from torch_radbp.bsdf.normalmap import NormalMap
from torch_radbp.bsdf.principled import Principled
from torch_radbp.bsdf.twosided import TwoSided
from torch_radbp.io.gltf import extension
from torch_radbp.io.gltf.document import Document, DocumentPart, Losses
from torch_radbp.io.gltf.names import Names
from torch_radbp.io.gltf.texture import GltfTextures, Image
from torch_radbp.plugin import BSDF, Plugin, Texture
from torch_radbp.texture.mesh_attribute import MeshAttribute
from torch_radbp.texture.rgb import RGB

STRONGEST = 1e5  # scale of a normal map, at most
VERTEX_COLOUR = "vertex_color"


class Look(NamedTuple):
    """The material, emission and texture coordinates of a surface."""

    bsdf: BSDF
    radiance: Texture | None  # emitted radiance
    uv_set: int | None  # index of the uv set that its textures read; None: they read none
    factor: tuple[float, float, float]  # factor of vertex colours, if these are its base colour; else (1, 1, 1)


class GltfMaterials:
    """Reads the looks (materials, emission) of a scene's surfaces, each at its first use."""

    def __init__(self, document: Document, textures: GltfTextures, losses: Losses, names: Names,
                 children: dict[str, Plugin]):
        self.document, self.textures, self.losses, self.names, self.children = document, textures, losses, names, children
        self.cached: dict[tuple[int | None, str | None, bool], Look] = {}

    def material(self, primitive: DocumentPart) -> DocumentPart:
        """The material of a primitive, in the document."""
        part = self.document.referred("materials", primitive, "material", None)
        return DocumentPart(self.document.file, "the default material", {}) if part is None else part

    def look(self, primitive: DocumentPart, colours: str | None, mirrored: bool) -> Look:
        """Reads the look of a primitive.

        Args:
            primitive: which refers to the material.
            colours: the attribute of its vertices or faces that holds their colours, if they have any.
            mirrored: its texture is mirrored, and the normal map is to be mirrored with it.
        """
        number, part = primitive.integer("material", None), self.material(primitive)
        key = number, colours, mirrored
        if key not in self.cached:
            name = "default" if number is None else part.text("name", "") or f"material_{number}"
            self.cached[key] = self.made(part, name, colours, mirrored)
        return self.cached[key]

    def made(self, part: DocumentPart, name: str, colours: str | None, mirrored: bool) -> Look:
        """Makes a new look, and adds its plugins to the scene."""
        sets: list[int] = []
        rough = part.part("pbrMetallicRoughness")
        image = self.textures.image(part, rough, "baseColorTexture", sets)
        *factor, alpha = rough.numbers("baseColorFactor", 4, [1, 1, 1, 1], low=0.0, high=1.0)
        if colours is not None and image is not None:
            self.losses.add(part.place, "colours of vertices (COLOR_0) are not read beside a baseColorTexture")
        if part.extension("KHR_materials_unlit") is not None:
            self.losses.add(part.place, "it is shaded, though the material is unlit")
        if part.has("occlusionTexture"):
            self.losses.add(part.place, "occlusionTexture is not read: light finds its way by itself")
        by_attribute = colours is not None and image is None
        base = MeshAttribute(name=colours) if by_attribute else tinted(image, factor)
        unique = self.names.free(name)
        bsdf = self.children[unique] = self.principled(part, rough, base, sets)
        bsdf = self.turned(part, bsdf, unique, sets, mirrored)
        if part.flag("doubleSided") and not bsdf.kind().transmits:
            bsdf = self.add(f"{unique}_twosided", TwoSided(brdf=[bsdf]))
        bsdf = self.masked(part, bsdf, unique, alpha, image)
        radiance = self.radiance(part, sets)
        return Look(bsdf, radiance, sets[0] if sets else None, tuple(factor) if by_attribute else (1.0, 1.0, 1.0))

    def add(self, name: str, bsdf: BSDF) -> BSDF:
        self.children[self.names.free(name)] = bsdf
        return bsdf

    def principled(self, part: DocumentPart, rough: DocumentPart, base: Texture, sets: list[int]) -> BSDF:
        """Makes the innermost material, `principled` or `diffuse`, as seen from its front."""
        image = self.textures.image(part, rough, "metallicRoughnessTexture", sets)
        numbers = {name: rough.number(f"{name}Factor", 1.0, low=0.0, high=1.0) for name in ("roughness", "metallic")}
        if extension.is_diffuse(part, numbers["metallic"]):
            return Diffuse(reflectance=base)
        arguments: dict[str, Any] = {"roughness": _scaled(image, 1, numbers["roughness"]),
                                     "metallic": _scaled(image, 2, numbers["metallic"])}
        arguments |= extension.reflection(part, self.losses) | extension.sheen(part, self.losses)
        arguments |= extension.anisotropy(part, numbers["roughness"] if image is None else None, self.losses)
        passes, coat = extension.transmission(part, self.losses), extension.clearcoat(part, self.losses)
        if passes is not None:
            image = self.textures.image(part, passes, "transmissionTexture", sets)
            arguments["spec_trans"] = _scaled(image, 0, passes.number("transmissionFactor"))
            if "specular" not in arguments:
                arguments.setdefault("eta", 1.5)
        if coat is not None:
            image = self.textures.image(part, coat, "clearcoatTexture", sets)
            arguments["clearcoat"] = _scaled(image, 0, coat.number("clearcoatFactor"))
            coat_roughness = coat.number("clearcoatRoughnessFactor", 0.0, low=0.0, high=1.0)
            arguments["clearcoat_gloss"] = extension.gloss_of(coat_roughness)
        return Principled(base_color=base, **arguments)

    def turned(self, part: DocumentPart, bsdf: BSDF, name: str, sets: list[int], mirrored: bool) -> BSDF:
        """Wraps the material in a normal map for its normalTexture, converted from glTF's y axis."""
        image = self.textures.image(part, part, "normalTexture", sets)
        if image is None:
            return bsdf
        strength = part.part("normalTexture").number("scale", 1.0, low=-STRONGEST, high=STRONGEST)
        factors = torch.tensor([strength, -strength if mirrored else strength, 1.0], dtype=torch.float64)
        normals = torch.from_numpy(image.texels[:, :, :3] / 127.5 - 1.0) * factors
        return self.add(f"{name}_normalmap", NormalMap(normalmap=image.bitmap(0.5 * normals + 0.5), nested_bsdf=bsdf))

    def masked(self, part: DocumentPart, bsdf: BSDF, name: str, alpha: float, image: Image | None) -> BSDF:
        """Wraps the material in an opacity mask."""
        mode = part.text("alphaMode", "OPAQUE")
        if mode not in ("OPAQUE", "MASK", "BLEND"):
            raise part.fail(f"alphaMode must be OPAQUE, MASK or BLEND, got {mode!r:.60}")
        opacity = torch.full((1, 1, 1), alpha, dtype=torch.float64) if image is None else image.channel(3) * alpha
        if mode == "MASK":
            opacity = (opacity >= part.number("alphaCutoff", 0.5, low=0.0)).to(torch.float64)
        if mode == "OPAQUE" or bool((opacity == 1).all()):
            return bsdf
        texture = opacity.item() if opacity.numel() == 1 else image.bitmap(opacity, "nearest" if mode == "MASK" else None)
        return self.add(f"{name}_mask", Mask(nested_bsdf=bsdf, opacity=texture))

    def radiance(self, part: DocumentPart, sets: list[int]) -> Texture | None:
        """Reads the emitted radiance; glTF's nits (cd / m^2) count as W / (m^2 sr)."""
        strength = part.extension("KHR_materials_emissive_strength")
        factor = [component * (1.0 if strength is None else strength.number("emissiveStrength", 1.0, low=0.0))
                  for component in part.numbers("emissiveFactor", 3, [0, 0, 0], low=0.0)]
        if max(factor) == 0:
            return None
        image = self.textures.image(part, part, "emissiveTexture", sets)
        if image is not None and not image.texels[:, :, :3].any():
            return None
        if part.flag("doubleSided"):
            self.losses.add(part.place, "it emits light from its front only")
        if part.text("alphaMode", "OPAQUE") != "OPAQUE":
            self.losses.add(part.place, "it emits light where it is transparent, too")
        return tinted(image, factor)


def tinted(image: Image | None, factor: list[float]) -> Texture:
    """A texture of a colour, or of an sRGB image times a colour."""
    colour = torch.tensor(factor, dtype=torch.float64)
    return RGB(value=colour) if image is None else image.bitmap(image.colour() * colour)


def _scaled(image: Image | None, channel: int, factor: float) -> Tensor | float | Texture:
    """A number, or one channel of an image times a number."""
    return factor if image is None or factor == 0 else image.bitmap(image.channel(channel) * factor)
