"""The extensions of glTF: which are read, and what those of materials become in `principled`.

| extension | becomes |
|---|---|
| KHR_materials_ior | `eta` |
| KHR_materials_transmission | `spec_trans`, of a solid body; without a thickness glTF means a thin sheet, which is a loss |
| KHR_materials_volume | that it is solid; absorption is a loss |
| KHR_materials_anisotropy | `anisotropic` and `roughness`, exactly, if both are numbers and the direction is that of u |
| KHR_materials_clearcoat | `clearcoat`, `clearcoat_gloss`: the same places and sharpness, a quarter of the strength |
| KHR_materials_sheen | `sheen`, `sheen_tint`: another curve |
| KHR_materials_specular | `specular`, which leaves reflections at grazing angles; 0 of what is no metal: `diffuse` |
| KHR_materials_emissive_strength | a factor of the radiance |

Of nodes, EXT_mesh_gpu_instancing makes a copy of the mesh for each instance, and KHR_node_visibility hides meshes and
lights. Buffer views that are compressed (EXT_meshopt_compression) are read from the buffer of the same uncompressed, where
there is one.
"""

from __future__ import annotations

import math
from typing import Any

from torch_radbp.bsdf.principled import MOST_SPECULAR
from torch_radbp.io.gltf.accessor import MESHOPT
from torch_radbp.io.gltf.document import Document, DocumentPart, Losses
from torch_radbp.plugin import nearest

READ = ("KHR_lights_punctual", "KHR_materials_anisotropy", "KHR_materials_clearcoat", "KHR_materials_emissive_strength",
        "KHR_materials_ior", "KHR_materials_sheen", "KHR_materials_specular", "KHR_materials_transmission",
        "KHR_materials_volume", "KHR_mesh_quantization", "KHR_node_visibility", "KHR_texture_transform",
        "EXT_mesh_gpu_instancing")
# What to do about an extension that a document requires.
INSTEAD = {"KHR_draco_mesh_compression": "save it without compression: import it into Blender, export it with it off",
           **dict.fromkeys(MESHOPT, "save it without compression: `gltfpack -noq`"),
           "KHR_texture_basisu": "save it without compression: images as PNG or JPEG",
           "KHR_materials_unlit": "all surfaces are lit here; where it is used and not required, the surface is shaded"}
# Of which is said elsewhere what is lost, or nothing is: views of buffers that are compressed are read from their fallback.
SAID_ELSEWHERE = (*MESHOPT, "KHR_materials_unlit")
ALIKE = 0.9  # a misspelt name; KHR_materials_unlit and KHR_materials_ior are alike by 0.83
SHARPEST, DULLEST = 0.001, 0.1  # roughness of Disney's clearcoat with gloss 1 and 0, as microfacets count it
SMALLEST_IOR = 1.0


def check_extensions(document: Document, losses: Losses) -> None:
    """Notes the extensions of a document that are not read.

    Raises:
        SceneError: if it requires one.
    """
    for name in document.items("extensionsRequired"):
        if name not in READ:
            instead = INSTEAD.get(name) if isinstance(name, str) else None
            raise document.fail(f"it requires the extension {name!r:.80}, which is not supported; "
                                f"{instead or nearest(str(name), READ, ALIKE)}")
    for name in document.items("extensionsUsed"):
        if name not in (*READ, *SAID_ELSEWHERE):
            losses.add("extensionsUsed", f"{name!r} is not read")


def reflection(material: DocumentPart, losses: Losses) -> dict[str, float]:
    """Reads `eta` or `specular` of the boundary; neither if it has the default of both."""
    ior, specular = material.extension("KHR_materials_ior"), material.extension("KHR_materials_specular")
    index = 1.5 if ior is None else ior.number("ior", 1.5, low=0.0)
    if index < SMALLEST_IOR:
        losses.add(material.place, f"ior {index:g} is read as 1.5: an index of refraction is at least {SMALLEST_IOR:g} here")
        index = 1.5
    factor = 1.0
    if specular is not None:
        factor = specular.number("specularFactor", 1.0, low=0.0, high=1.0)
        for name in ("specularTexture", "specularColorTexture"):
            if specular.has(name):
                losses.add(material.place, f"{name} is not read")
        if specular.numbers("specularColorFactor", 3, [1, 1, 1], low=0.0) != [1, 1, 1]:
            losses.add(material.place, "specularColorFactor is not read: reflections of what is no metal stay white")
    if factor == 1.0:
        return {} if ior is None else {"eta": index}
    losses.add(material.place, f"specularFactor {factor:g} weakens reflections from above, not at grazing angles")
    return {"specular": min(MOST_SPECULAR, factor * ((index - 1.0) / (index + 1.0)) ** 2 / 0.08)}


def is_diffuse(material: DocumentPart, metallic: float) -> bool:
    """True if only the diffuse base has an effect: no metal, no reflections, no layer."""
    specular = material.extension("KHR_materials_specular")
    layers = ("KHR_materials_transmission", "KHR_materials_clearcoat", "KHR_materials_sheen")
    return (metallic == 0 and specular is not None and specular.number("specularFactor", 1.0) == 0
            and not specular.has("specularTexture") and all(material.extension(name) is None for name in layers))


def anisotropy(material: DocumentPart, roughness: float | None, losses: Losses) -> dict[str, float]:
    """Reads `anisotropic`, and the `roughness` that goes with it; nothing if the material is isotropic.

    Along and across the direction, microfacets have the roughness a + (1 - a) s^2 and a there, with a = roughness^2 and the
    strength s; here roughness^2 / w and roughness^2 w, with w^2 = 1 - 0.9 anisotropic.

    Args:
        material: the whole of it.
        roughness: None if it is a texture.
    """
    extension = material.extension("KHR_materials_anisotropy")
    strength = 0.0 if extension is None else extension.number("anisotropyStrength", 0.0, low=0.0, high=1.0)
    if strength == 0:
        return {}
    if roughness is None or extension.has("anisotropyTexture") or extension.number("anisotropyRotation", 0.0) != 0:
        losses.add(material.place, "anisotropy is not read: it and the roughness must be numbers, its direction that of u")
        return {}
    across = max(roughness * roughness, 1e-6)
    along = across + (1.0 - across) * strength * strength
    if across < 0.1 * along:
        losses.add(material.place, "anisotropy is limited to a ratio of roughness of 10")
    return {"anisotropic": min(1.0, (1.0 - across / along) / 0.9), "roughness": (along * across) ** 0.25}


def transmission(material: DocumentPart, losses: Losses) -> DocumentPart | None:
    """The extension KHR_materials_transmission, or None if it transmits no light."""
    extension, volume = (material.extension(f"KHR_materials_{name}") for name in ("transmission", "volume"))
    if extension is None or extension.number("transmissionFactor", 0.0, low=0.0, high=1.0) == 0:
        return None
    if volume is None or volume.number("thicknessFactor", 0.0, low=0.0) == 0:
        losses.add(material.place, "transmission is that of a solid body, not of a thin sheet")
    elif volume.number("attenuationDistance", math.inf, low=0.0) < math.inf:
        losses.add(material.place, "attenuation inside of the body is not read")
    return extension


def clearcoat(material: DocumentPart, losses: Losses) -> DocumentPart | None:
    """The extension KHR_materials_clearcoat, or None if it has no effect."""
    extension = material.extension("KHR_materials_clearcoat")
    if extension is None or extension.number("clearcoatFactor", 0.0, low=0.0, high=1.0) == 0:
        return None
    losses.add(material.place, "clearcoat is that of principled: a quarter as strong, and the base below is not darker")
    for name in ("clearcoatRoughnessTexture", "clearcoatNormalTexture"):
        if extension.has(name):
            losses.add(material.place, f"{name} is not read")
    return extension


def gloss_of(roughness: float) -> float:
    """`clearcoat_gloss` for a roughness of glTF's."""
    return min(1.0, max(0.0, (DULLEST - roughness * roughness) / (DULLEST - SHARPEST)))


def roughness_of(gloss: float) -> float:
    """glTF's roughness for a `clearcoat_gloss`: the inverse of `gloss_of`."""
    return math.sqrt(DULLEST + (SHARPEST - DULLEST) * gloss)


def sheen(material: DocumentPart, losses: Losses) -> dict[str, Any]:
    """Reads KHR_materials_sheen as `sheen` and `sheen_tint` of the material."""
    extension = material.extension("KHR_materials_sheen")
    colour = [0.0] if extension is None else extension.numbers("sheenColorFactor", 3, [0, 0, 0], low=0.0, high=1.0)
    if max(colour) == 0:
        return {}
    losses.add(material.place, "sheen is that of principled, which has another curve and no roughness")
    for name in ("sheenColorTexture", "sheenRoughnessTexture"):
        if extension.has(name):
            losses.add(material.place, f"{name} is not read")
    tinted = max(colour) - min(colour) > 0.01 * max(colour)
    return {"sheen": max(colour), **({"sheen_tint": 1.0} if tinted else {})}
