"""Materials on lanes of directions, for the tests."""

from __future__ import annotations

from torch import Tensor

from torch_radbp.bsdf.kind import Kind, Values
from torch_radbp.check.lanes import LaneNumbers, choices, direction, directions, random_numbers, sampled
from torch_radbp.plugin import BSDF, REGISTRY
from torch_radbp.tensors.vec import Vec3

__all__ = ["LaneNumbers", "choices", "direction", "directions", "random_numbers", "sampled"]  # and the materials below


def material(description: dict) -> BSDF:
    """The plugin that a dict of Mitsuba's vocabulary describes."""
    return plugin(description).double()


def plugin(value):
    """The plugin for a dict, the plugins for a list of dicts; other values as they are."""
    if isinstance(value, list) and isinstance(value[0], dict):
        return [plugin(item) for item in value]
    if not isinstance(value, dict):
        return value
    attributes = {name: plugin(item) for name, item in value.items() if name != "type"}
    return REGISTRY["bsdf"][value["type"]](**attributes)


def as_dict(description: dict) -> dict:
    """A description as the loaders take it: lists of numbers are colours, those of materials are children in order."""
    found = {}
    for name, value in description.items():
        if isinstance(value, list) and isinstance(value[0], dict):
            found |= {f"{name}_{number}": as_dict(item) for number, item in enumerate(value)}
        elif isinstance(value, list):
            found[name] = {"type": "rgb", "value": value}
        else:
            found[name] = as_dict(value) if isinstance(value, dict) else value
    return found


def values_of(bsdf: BSDF, like: Tensor) -> Values:
    """The values of a material of constant textures on every lane, attached to its parameters."""
    return tuple(Vec3.of(texture.texels().reshape(3).to(like).expand(len(like), 3)) for texture in bsdf.textures())


# One material of every kind and option, none of them special.
MATERIALS = {
    "diffuse": {"type": "diffuse", "reflectance": [0.2, 0.5, 0.9]},
    "conductor": {"type": "conductor", "material": "Au", "specular_reflectance": [0.9, 0.6, 0.8]},
    "dielectric": {"type": "dielectric", "int_ior": 1.5, "specular_reflectance": [0.9, 0.5, 0.7],
                   "specular_transmittance": [0.4, 0.9, 0.6]},
    "thin": {"type": "dielectric", "int_ior": 1.0, "ext_ior": 1.33},
    "pane": {"type": "thindielectric", "int_ior": 1.5, "specular_reflectance": [0.9, 0.5, 0.7],
             "specular_transmittance": [0.4, 0.9, 0.6]},
    "pane of air": {"type": "thindielectric", "int_ior": 1.0, "ext_ior": 1.33},
    "plastic": {"type": "plastic", "diffuse_reflectance": [0.2, 0.5, 0.9], "specular_reflectance": [0.9, 0.6, 0.8]},
    "nonlinear plastic": {"type": "plastic", "int_ior": 1.9, "diffuse_reflectance": [0.8, 0.5, 0.1], "nonlinear": True},
}
for _name in ("beckmann", "ggx"):
    _rough = {"distribution": _name, "alpha": 0.3}
    _brushed = {"distribution": _name, "alpha_u": 0.15, "alpha_v": 0.6}
    _glass = {"int_ior": 1.5, "specular_reflectance": [0.9, 0.5, 0.7], "specular_transmittance": [0.4, 0.9, 0.6]}
    MATERIALS |= {
        f"metal {_name}": {"type": "roughconductor", **_rough, "material": "Cu", "specular_reflectance": [0.9, 0.6, 0.8]},
        f"brushed metal {_name}": {"type": "roughconductor", **_brushed, "eta": [1.5, 0.2, 0.9], "k": [0.0, 3.0, 1.0]},
        f"glass {_name}": {"type": "roughdielectric", **_rough, **_glass},
        f"brushed glass {_name}": {"type": "roughdielectric", **_brushed, "int_ior": "diamond"},
        f"bubble {_name}": {"type": "roughdielectric", **_rough, "int_ior": 1.0, "ext_ior": 1.33},
        f"rough plastic {_name}": {"type": "roughplastic", **_rough, "diffuse_reflectance": [0.2, 0.5, 0.9],
                                   "specular_reflectance": [0.9, 0.6, 0.8]},
    }
MATERIALS["rough nonlinear plastic"] = {"type": "roughplastic", "alpha": 0.2, "int_ior": 1.9, "nonlinear": True,
                                        "diffuse_reflectance": [0.8, 0.5, 0.1]}
_pink = {"type": "principled", "base_color": [0.8, 0.2, 0.4]}
MATERIALS |= {
    "principled": _pink | {"roughness": 0.45},
    "principled metal": _pink | {"roughness": 0.4, "anisotropic": 0.6, "metallic": 0.7, "eta": 1.7},
    "principled cloth": _pink | {"specular": 0.8, "spec_tint": 0.6, "sheen": 0.7, "sheen_tint": 0.4, "flatness": 0.6},
    "principled lacquer": _pink | {"clearcoat": 0.8, "diffuse_reflectance_sampling_rate": 0.6,
                                   "main_specular_sampling_rate": 1.5, "clearcoat_sampling_rate": 2.0},
    "principled glass": _pink | {"roughness": 0.5, "spec_trans": 0.7, "eta": 1.4},
    "principled bubble": _pink | {"roughness": 0.5, "spec_trans": 0.6, "metallic": 0.2, "eta": 0.7, "spec_tint": 0.4},
    "principled with all": _pink | {
        "roughness": 0.4, "anisotropic": 0.5, "metallic": 0.3, "spec_trans": 0.4, "specular": 0.7, "spec_tint": 0.3,
        "sheen": 0.5, "sheen_tint": 0.6, "clearcoat": 0.7, "clearcoat_gloss": 0.2, "flatness": 0.4},
}
_sheet = {"type": "principledthin", "base_color": [0.8, 0.2, 0.4]}
MATERIALS |= {
    "sheet": _sheet | {"roughness": 0.4},
    "film": _sheet | {"roughness": 0.5, "spec_trans": 0.7, "eta": 1.6, "anisotropic": 0.5, "spec_tint": 0.6},
    "paper": _sheet | {"diff_trans": 0.8, "sheen": 0.7, "sheen_tint": 0.4, "flatness": 0.6,
                       "diffuse_transmittance_sampling_rate": 1.5},
    "sheet with all": _sheet | {
        "roughness": 0.6, "anisotropic": 0.4, "spec_trans": 0.4, "eta": 1.3, "spec_tint": 0.3, "sheen": 0.5,
        "sheen_tint": 0.6, "flatness": 0.4, "diff_trans": 1.2, "specular_reflectance_sampling_rate": 0.7},
}
MATERIALS |= {
    "hidden metal beckmann": {"type": "roughconductor", "material": "Au", "alpha": 0.3, "sample_visible": False},
    "hidden metal ggx": {"type": "roughconductor", "distribution": "ggx", "material": "Cu", "alpha_u": 0.2, "alpha_v": 0.5,
                         "sample_visible": False},
    "hidden glass beckmann": {"type": "roughdielectric", "alpha": 0.3, "sample_visible": False},
    "hidden plastic ggx": {"type": "roughplastic", "distribution": "ggx", "alpha": 0.4, "sample_visible": False,
                           "diffuse_reflectance": [0.2, 0.5, 0.8]},
}
_plastic, _green = MATERIALS["plastic"], {"type": "diffuse", "reflectance": [0.2, 0.8, 0.3]}
MATERIALS |= {
    "null": {"type": "null"},
    "blend of principled": {"type": "blendbsdf", "weight": 0.4, "bsdf": [MATERIALS["principled glass"], _green]},
    "blend": {"type": "blendbsdf", "weight": 0.3, "bsdf": [_green, MATERIALS["metal ggx"]]},
    "blend of mixed": {"type": "blendbsdf", "weight": 0.6, "bsdf": [_plastic, MATERIALS["conductor"]]},
    "nested blend": {"type": "blendbsdf", "weight": 0.7, "bsdf": [
        MATERIALS["glass ggx"], {"type": "blendbsdf", "weight": 0.4, "bsdf": [MATERIALS["dielectric"], _plastic]}]},
    "blend of deltas": {"type": "blendbsdf", "weight": 0.6, "bsdf": [MATERIALS["dielectric"], MATERIALS["conductor"]]},
    "mask": {"type": "mask", "opacity": 0.7, "nested_bsdf": MATERIALS["metal ggx"]},
    "leaf": {"type": "mask", "opacity": 0.6, "nested_bsdf": {"type": "twosided", "brdf": [_green]}},
    "two faces": {"type": "blendbsdf", "weight": 0.5, "bsdf": [
        {"type": "twosided", "brdf": [_plastic, _green]}, MATERIALS["glass ggx"]]},
    "bumps": {"type": "normalmap", "normalmap": [0.6, 0.4, 0.9], "nested_bsdf": MATERIALS["rough plastic ggx"]},
    "brushed bumps": {"type": "normalmap", "normalmap": [0.6, 0.55, 0.9], "nested_bsdf": MATERIALS["brushed metal ggx"],
                      "use_shadowing_function": False},
    "mirror with bumps": {"type": "normalmap", "normalmap": [0.55, 0.6, 0.9], "nested_bsdf": MATERIALS["conductor"],
                          "flip_invalid_normals": False},
    "glass with bumps": {"type": "normalmap", "normalmap": [0.55, 0.6, 0.9], "nested_bsdf": MATERIALS["glass ggx"]},
    # Of bump maps the texture's value stands for the slope along u and v.
    "hills": {"type": "bumpmap", "nested_texture": 0.3, "scale": -1.4, "nested_bsdf": MATERIALS["metal ggx"]},
    "glass with hills": {"type": "bumpmap", "nested_texture": 0.2, "nested_bsdf": MATERIALS["glass ggx"]},
}


def kind_of(name: str) -> Kind:
    """The scattering functions of one of `MATERIALS`."""
    return material(MATERIALS[name]).kind()


KINDS = {name: kind_of(name) for name in MATERIALS}
DELTA = [name for name, kind in KINDS.items() if kind.delta]
SMOOTH = [name for name, kind in KINDS.items() if kind.smooth]
IDEAL = [name for name in DELTA if name not in SMOOTH]
MIXED = [name for name in DELTA if name in SMOOTH]
TRANSMITTING = [name for name, kind in KINDS.items() if kind.transmits]
ROUGH = [name for name in SMOOTH if name != "diffuse"]
NESTED = [name for name, description in MATERIALS.items() if "bsdf" in description or "nested_bsdf" in description]
SIMPLE = [name for name in MATERIALS if name not in NESTED]
GLASS = [name for name in ROUGH if MATERIALS[name]["type"] == "roughdielectric"]
