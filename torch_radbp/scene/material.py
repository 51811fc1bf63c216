"""Scattering at a surface point: the BSDF there, whichever kind of material each lane meets."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.bsdf.kind import Kind, Values
from torch_radbp.lookup import lookup
from torch_radbp.scene.interaction import SurfaceInteraction
from torch_radbp.scene.tensors import SceneTensors
from torch_radbp.texture.bank import sample_texture
from torch_radbp.vec import Vec3, where

LEAST_DENSITY = 1e-15  # of a direction that can be drawn; the square of its reciprocal is finite in float32
HARMLESS = 0.5  # for lanes of other kinds: a value at which every kind of material is finite


class Material(NamedTuple):
    """The material of each lane, with the values of its textures."""

    kinds: tuple[Kind, ...]  # all that the scene has
    kind: Tensor | None  # (N,) int32, which of them; None if there is one
    values: Values  # (N,) each: the values that the functions of a kind take, then unused ones

    def of(self, number: int) -> Values:
        """The values for kind `number`; harmless ones where a lane is of another kind."""
        values = self.values[:self.kinds[number].slots]
        if self.kind is None:
            return values
        mine, other = self.kind == number, Vec3.full(values[0].x, HARMLESS)
        return tuple(where(mine, value, other) for value in values)

    @property
    def discrete(self) -> bool:
        """True if `sample` has to choose between reflection and transmission."""
        return any(kind.discrete for kind in self.kinds)

    def detach(self) -> Material:
        return self._replace(values=tuple(value.detach() for value in self.values))


class BSDFSample(NamedTuple):
    """A direction in which the path continues."""

    wo: Vec3  # unit, local; attached if the lane is `followed`
    weight: Vec3  # bsdf * |cos| / pdf; attached to the material, the density only if the lane is `followed`
    pdf: Tensor  # density over solid angle; infinite for ideal specular scattering; 0: the path ends


def material_at(scene: SceneTensors, si: SurfaceInteraction) -> Material:
    """Reads the textures of the material at a surface point, on the side that the ray meets."""
    uv = si.uv if scene.layout.reflectance_bitmaps else None
    table, kinds = scene.materials, scene.layout.kinds
    values = tuple(sample_texture(scene.reflectance, lookup(slot, si.material), uv) for slot in table.slots)
    return Material(kinds, None if len(kinds) == 1 else lookup(table.kind, si.material), values)


def evaluate(material: Material, wi: Vec3, wo: Vec3) -> tuple[Vec3, Tensor]:
    """bsdf * |cos|, local frame, and the density over solid angle with which `sample` draws `wo`; attached.

    Both are zero for ideal specular materials.
    """
    parts = [kind.eval_pdf(material.of(number), wi, wo) for number, kind in enumerate(material.kinds)]
    return tuple(chosen(material.kind, list(part)) for part in zip(*parts))


def followed(kind: Kind, sampling: str) -> bool:
    """True if the directions that `sample` draws for this kind of material carry derivatives."""
    return sampling == "attached" or (sampling == "hybrid" and kind.delta)


def sample(material: Material, wi: Vec3, choice: Tensor | None, u: Tensor, v: Tensor, sampling: str) -> BSDFSample:
    """Draws a direction by the material.

    Args:
        choice, u, v: (N,) uniform numbers, the first for reflection or transmission (None: not `material.discrete`).
        sampling: which derivatives the sample carries, see `followed`.
    """
    fixed = material.detach()
    samples = [sample_kind(kind, material.of(number), fixed.of(number), wi, choice, u, v, followed(kind, sampling))
               for number, kind in enumerate(material.kinds)]
    return BSDFSample(*(chosen(material.kind, list(parts)) for parts in zip(*samples)))


def sample_kind(kind: Kind, values: Values, fixed: Values, wi: Vec3, choice: Tensor | None, u: Tensor, v: Tensor,
                follow: bool) -> BSDFSample:
    """`sample` for one kind of material. The choice between reflection and transmission never carries a derivative."""
    decision = kind.choose(fixed, wi.detach(), choice, u, v)
    wo = kind.sample(values, wi, decision, u, v) if follow else kind.sample(fixed, wi, decision, u, v).detach()
    if not kind.smooth:
        weight = kind.specular(values, wi, decision) * (1.0 / decision.probability.clamp_min(LEAST_DENSITY))
        return BSDFSample(wo, weight, torch.full_like(u, torch.inf))
    value, pdf = kind.eval_pdf(values, wi, wo)
    density = kind.eval_pdf(values, wi, wo, fixed_lobes=True)[1] if follow else pdf.detach()
    return BSDFSample(wo, value * density.clamp_min(LEAST_DENSITY).reciprocal(), pdf if follow else density)


def chosen(kind: Tensor | None, parts: list):
    """The result of each lane's own kind, from the results of all kinds."""
    result = parts[0]
    for number, part in enumerate(parts[1:], start=1):
        mine = kind == number
        result = where(mine, part, result) if isinstance(part, Vec3) else torch.where(mine, part, result)
    return result
