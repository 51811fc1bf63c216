"""Writes the materials of shapes, with all that is nested in them and what they emit, as glTF materials."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from torch import nn

from torch_radbp.io.gltf.document import Losses
from torch_radbp.io.gltf.image_slot import Reading, Slot, joined_slots, quantised, slot, texture_info
from torch_radbp.io.gltf.names import Names
from torch_radbp.io.gltf.surface import GltfSurface, constant_slot, surface_of
from torch_radbp.io.gltf.written import Written
from torch_radbp.plugin import BSDF, Plugin, SceneError, Shape, Texture
from torch_radbp.scene.modules.scene import name_in


class Peeled(NamedTuple):
    """A material, with what the materials around it (mask, two-sided, normal map) add."""

    inner: BSDF
    opacity: Texture | None
    double_sided: bool
    normals: Texture | None
    invisible: bool


class PrimitiveMaterial(NamedTuple):
    """The glTF material of a primitive, and what the primitive's mesh must store for it."""

    material: int
    colours: tuple[str, float] | None  # attribute of vertices or faces that is the base colour, and a factor


class Appearances:
    """Writes glTF materials, one for each distinct look.

    Args:
        root: the scene, or a shape by itself, whose materials are named by their places in it.
        out: the document, to which materials are added.
        losses: what glTF cannot represent is added to them.
    """

    def __init__(self, root: nn.Module, out: Written, losses: Losses):
        self.root, self.out, self.losses, self.names = root, out, losses, Names()
        for name, _ in root.named_children():  # so that none comes back as another
            self.names.free(name)
        self.named: set[str] = set()
        self.cached: dict[tuple[int, int, bool], PrimitiveMaterial] = {}

    def of(self, shape: Shape, mirrored: bool) -> PrimitiveMaterial:
        """Writes the material of a shape and returns its record; `mirrored`: its uv are mirrored, see `read.is_mirrored`."""
        peeled = self.peeled(shape.bsdf)
        key = id(shape.bsdf), id(shape.emitter), mirrored and peeled.normals is not None
        if key not in self.cached:
            self.cached[key] = self.written(shape, peeled, key[2])
        return self.cached[key]

    def peeled(self, bsdf: BSDF) -> Peeled:
        """Separates a material from the materials around it (mask, two-sided, normal map)."""
        peeled, name = Peeled(bsdf, None, False, None, False), name_in(self.root, bsdf)
        while True:
            outer = peeled.inner
            if not isinstance(outer, Plugin) or not outer.type:
                raise SceneError(f"{name}: a {type(outer).__name__} cannot be written as glTF, only Mitsuba's plugins can")
            if outer.type == "twosided":
                if len(outer.brdf) > 1:
                    self.losses.add(name, "the material of its back is not written")
                peeled = peeled._replace(inner=outer.brdf[0], double_sided=True)
            elif outer.type == "mask" and peeled.opacity is None:
                peeled = peeled._replace(inner=outer.nested_bsdf, opacity=outer.opacity)
            elif outer.type == "normalmap" and peeled.normals is None:
                peeled = peeled._replace(inner=outer.nested_bsdf, normals=outer.normalmap)
            elif outer.type == "null":
                return peeled._replace(invisible=True)
            elif outer.type == "blendbsdf":
                self.losses.add(name, "of a blendbsdf the first material is written alone")
                peeled = peeled._replace(inner=outer.bsdf_0)
            elif hasattr(outer, "nested_bsdf"):
                self.losses.add(name, f"what {outer.type} adds to its material is not written")
                peeled = peeled._replace(inner=outer.nested_bsdf)
            else:
                return peeled

    def written(self, shape: Shape, peeled: Peeled, mirrored: bool) -> PrimitiveMaterial:
        """Writes a new glTF material."""
        full = name_in(self.root, peeled.inner)
        surface = GltfSurface() if peeled.invisible else surface_of(peeled.inner, full, self.losses)
        entries: dict[str, Any] = {"name": self.names.free(full) if full in self.named else full}
        self.named.add(full)
        extensions = {name: dict(values) for name, values in surface.extensions.items()}
        rough = self.metallic_roughness(entries["name"], surface)
        if peeled.invisible:
            rough["baseColorFactor"], entries["alphaMode"] = [1.0, 1.0, 1.0, 0.0], "BLEND"
        else:
            self.base(entries, rough, surface, peeled)
        entries["pbrMetallicRoughness"] = rough
        if peeled.normals is not None:
            entries["normalTexture"] = self.normals(entries["name"], peeled.normals, mirrored)
        if peeled.double_sided:
            entries["doubleSided"] = True
        for kind, values in (("transmission", surface.transmission), ("clearcoat", surface.clearcoat)):
            if values.values.any():
                extension = extensions.setdefault(f"KHR_materials_{kind}", {})
                extension |= self.scalar(f"{entries['name']}_{kind}", kind, values)
        if shape.emitter is not None:
            self.emission(entries, extensions, shape)
        if extensions:
            entries["extensions"] = {}
            for name, values in extensions.items():
                entries["extensions"] |= self.out.extension(name, values)
        colours = None if surface.colours is None else (surface.colours, surface.base.number())
        return PrimitiveMaterial(self.out.add("materials", entries), colours)

    def base(self, entries: dict[str, Any], rough: dict[str, Any], surface: GltfSurface, peeled: Peeled) -> None:
        """Writes base colour and opacity, which share an image."""
        name = entries["name"]
        opacity = constant_slot(1.0)
        if peeled.opacity is not None:
            opacity = slot(peeled.opacity, f"{name}.opacity", self.losses, as_number=True)
        base = constant_slot(1.0) if surface.colours is not None else surface.base
        image = joined_slots({"base_color": base, "opacity": opacity}, name, self.losses)
        for what, values in (("base colour", base.values), ("opacity", opacity.values)):
            self.lose_beyond(f"{name}: its {what}", values)
        if image is None:
            factor = [*base.constant.clip(0, 1).tolist(), min(1.0, max(0.0, opacity.number()))]
            is_cut = factor[3] == 0
        else:
            slots, reading = image
            height, width = np.broadcast_shapes(*(values.shape for values in slots.values()))[:2]
            parts = [np.broadcast_to(slots["base_color"], (height, width, 3))]
            if peeled.opacity is not None:
                parts.append(np.broadcast_to(slots["opacity"][..., :1], (height, width, 1)))
            values = np.concatenate(parts, axis=2).clip(0.0, 1.0)
            pixels, scale = quantised(values, srgb=True)
            factor = [*scale.tolist(), 1.0][:4]
            rough["baseColorTexture"] = texture_info(self.out, pixels, reading, f"{name}_base_color", self.losses)
            is_cut = reading.nearest and bool(np.isin(values[..., 3:], (0, 1)).all())
        if factor != [1.0, 1.0, 1.0, 1.0]:
            rough["baseColorFactor"] = factor
        if peeled.opacity is not None:
            entries["alphaMode"] = "MASK" if is_cut else "BLEND"

    def metallic_roughness(self, name: str, surface: GltfSurface) -> dict[str, Any]:
        """Writes roughness and metallic, which share an image, in its green and blue channels."""
        slots = {"roughness": surface.roughness, "metallic": surface.metallic}
        image = joined_slots(slots, name, self.losses)
        numbers = {key: min(1.0, max(0.0, each.number())) for key, each in slots.items()}
        for key, each in slots.items():
            self.lose_beyond(f"{name}: its {key}", each.values)
        if image is None:
            return {f"{key}Factor": number for key, number in numbers.items()}
        images, reading = image
        # A constant is a factor of white, so that it keeps all its digits.
        whole = {key: np.ones_like(images[key]) if each.is_constant else images[key] for key, each in slots.items()}
        height, width = np.broadcast_shapes(*(values.shape for values in whole.values()))[:2]
        pixels = np.ones((height, width, 3))
        pixels[..., 1:2], pixels[..., 2:3] = (values[..., :1].clip(0.0, 1.0) for values in whole.values())
        pixels, scale = quantised(pixels, srgb=False)
        factors = {f"{key}Factor": numbers[key] if slots[key].is_constant else float(scale[channel])
                   for channel, key in ((1, "roughness"), (2, "metallic"))}
        info = texture_info(self.out, pixels, reading, f"{name}_metallic_roughness", self.losses)
        return {**factors, "metallicRoughnessTexture": info}

    def lose_beyond(self, what: str, values: np.ndarray) -> None:
        """Notes values outside of [0, 1], which glTF cannot represent."""
        if values.min() < 0 or values.max() > 1:
            self.losses.add(what, f"{values.min():.4g} to {values.max():.4g}, is cut to [0, 1]")

    def scalar(self, name: str, kind: str, values: Slot) -> dict[str, Any]:
        """Writes a scalar: a factor, and an image whose red channel it multiplies."""
        if values.is_constant:
            return {f"{kind}Factor": min(1.0, max(0.0, values.number()))}
        pixels, scale = quantised(values.values.clip(0.0, 1.0), srgb=False)
        return {f"{kind}Factor": float(scale[0]),
                f"{kind}Texture": texture_info(self.out, pixels, values.reading, name, self.losses)}

    def normals(self, name: str, texture: Texture, mirrored: bool) -> dict[str, Any]:
        """Writes a normal map and returns its texture info: unit normals, unless 8 bits represent them exactly."""
        normals = slot(texture, f"{name}.normalmap", self.losses)
        values = normals.values.copy()
        if mirrored:
            values[..., 1] = 1.0 - values[..., 1]
        if np.abs(values * 255 - np.round(values * 255)).max() > 1e-2 or values.min() < 0 or values.max() > 1:
            vectors = 2.0 * values - 1.0
            length = np.linalg.norm(vectors, axis=2, keepdims=True)
            vectors = np.where(length > 1e-6, vectors / np.maximum(length, 1e-6), (0.0, 0.0, 1.0))
            if (vectors[..., 2] <= 0).any():
                self.losses.add(name, "normals of its normal map that point inwards are not as glTF wants them")
            values = 0.5 * vectors + 0.5
        pixels = np.round(values * 255).clip(0, 255).astype(np.uint8)
        return texture_info(self.out, pixels, normals.reading or Reading(), f"{name}_normal", self.losses)

    def emission(self, entries: dict[str, Any], extensions: dict[str, Any], shape: Shape) -> None:
        """Writes the emission of a shape."""
        name = f"{name_in(self.root, shape)}.emitter"
        if shape.emitter.type != "area":
            self.losses.add(name, f"a {shape.emitter.type} emitter is written as one that shines into all directions alike")
        if entries.get("doubleSided"):
            self.losses.add(name, "it shines from both sides in glTF")
        radiance = slot(shape.emitter.radiance, f"{name}.radiance", self.losses)
        if radiance.is_constant:
            factor = radiance.constant
        else:
            pixels, factor = quantised(radiance.values, srgb=True)
            title = f"{entries['name']}_emissive"
            entries["emissiveTexture"] = texture_info(self.out, pixels, radiance.reading, title, self.losses)
        strength = max(1.0, float(factor.max()))
        entries["emissiveFactor"] = (factor / strength).tolist()
        if strength > 1:
            extensions["KHR_materials_emissive_strength"] = {"emissiveStrength": strength}
