"""Materials on lanes of directions, for the tests."""

from __future__ import annotations

import torch
from torch import Tensor

from tests.scenes.materials import MATERIALS
from torch_radbp.check.lanes import LaneNumbers, choices, direction, directions, random_numbers, sampled
from torch_radbp.interface.bsdf import Kind, Values
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


def values_of(bsdf: BSDF, like: Tensor) -> Values:
    """The values of a material of constant textures on every lane, attached to its parameters."""
    return tuple(Vec3.of(texture.texels().reshape(3).to(like).expand(len(like), 3)) for texture in bsdf.textures())


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


def light(wo: Vec3) -> torch.Tensor:
    """Smooth radiance from all sides, without symmetry."""
    return torch.exp(0.8 * wo.x - 0.5 * wo.y + 0.6 * wo.z) + 0.3 * torch.sin(3 * wo.x + 2 * wo.y * wo.z)
