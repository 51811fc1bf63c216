"""The BSDF at surface points of one kind of material: textures read, evaluated and sampled."""

from __future__ import annotations

import itertools
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.interface.bsdf import Kind, LobeChoice, Values, values_for_choice
from torch_radbp.interface.texture import Place, TextureValue
from torch_radbp.scene.tables.scene_tensors import SceneTensors
from torch_radbp.tensors.differentiated import settled
from torch_radbp.tensors.lookup import lookup, untapped
from torch_radbp.tensors.vec import Vec3, dot, where
from torch_radbp.vertex.interaction import SurfaceInteraction

LEAST_COSINE = 1e-6
LEAST_DENSITY = 1e-15  # of a direction that can be drawn; the square of its reciprocal is finite in float32


class Material(NamedTuple):
    """The material of each lane: the kind of BSDF, with the values of its textures."""

    kind: Kind
    values: Values  # (N,) each
    # Where paths begin at lamps the unit geometric normal, local: `evaluate` and `sample` are of the adjoint BSDF then, with
    # `wi` towards the lamp. None: paths begin at cameras.
    normal: Vec3 | None = None

    def detach(self) -> Material:
        return self._replace(values=tuple(value.detach() for value in self.values))

    def turned(self, wi: Vec3, wo: Vec3) -> Tensor:
        """The ratio |cos wo| / |cos wi| by the geometric normal: paths from lamps carry power, which arrives per area."""
        return dot(self.normal, wo).abs() / dot(self.normal, wi).abs().clamp_min(LEAST_COSINE)


class BSDFSample(NamedTuple):
    """A direction sampled from a BSDF, in which the path continues."""

    wo: Vec3  # unit, local; attached where the direction is followed
    weight: Vec3  # bsdf * |cos| / pdf; attached to the material, the density only if all directions are followed
    pdf: Tensor  # density over solid angle; infinite for ideal specular scattering; 0: the path ends


def material_at(scene: SceneTensors, si: SurfaceInteraction, texture_values: tuple[TextureValue, ...]) -> Material:
    """Evaluates the material's textures at a surface point, on the side that the ray meets.

    Args:
        scene: the part that the lanes read.
        si: the surface point.
        texture_values: the values of the material's network textures, in order.
    """
    readers, appearance = scene.layout.readers, scene.layout.scatterer
    values, of_others = [], iter(texture_values)
    still, = scene.layout.still or (itertools.repeat(False),)
    for reader, slot, is_still in zip(appearance.readers, scene.materials.slots, still):
        if reader.outside:
            values.append(reader.value(next(of_others).at(reader.place(si.p, si.point.uv)), si.point))
        else:
            bank = scene.textures[readers.index(reader)]
            values.append(reader.read(untapped(bank) if is_still else bank, lookup(slot, si.material), si.point))
    if scene.layout.from_lamps:
        return Material(appearance.kind.adjoint(), tuple(values), si.frame.to_local(si.n))
    return Material(appearance.kind, tuple(values))


def material_places(scene: SceneTensors, si: SurfaceInteraction) -> tuple[Place, ...]:
    """The points at which the material's network textures are evaluated; args as for `material_at`."""
    return tuple(Place(lookup(slot, si.material), reader.place(si.p, si.point.uv))
                 for reader, slot in zip(scene.layout.scatterer.readers, scene.materials.slots) if reader.outside)


def evaluate(material: Material, wi: Vec3, wo: Vec3) -> tuple[Vec3, Tensor]:
    """The BSDF times |cos|, and the solid-angle density with which `sample` draws `wo`; local frame; attached.

    Both are zero for ideal specular materials. On paths from lamps it is the adjoint BSDF, for light that comes from `wi`:
    the BSDF with directions exchanged, with the cosine of `wi`, and squares of indices of refraction as for light from `wo`.

    Reference: Veach 1997, "Robust Monte Carlo Methods for Light Transport Simulation", sections 5.2 and 5.3.
    """
    if material.normal is None:
        return material.kind.eval_pdf(material.values, wi, wo)
    value = material.kind.eval(material.values, wo, wi) * material.turned(wi, wo)
    return value, material.kind.pdf(material.values, wi, wo)


def followed(kind: Kind, sampling: str) -> bool:
    """True if directions sampled from this kind of material carry derivatives: all, or those of delta lobes."""
    return sampling == "attached" or (sampling == "hybrid" and (kind.delta or kind.follows))


def sampling_at(kind: Kind, sampling: str) -> str:
    """The sampling mode of a kind of material: "attached" where "hybrid" differentiates its smooth lobes, too."""
    return "attached" if sampling == "hybrid" and kind.follows else sampling


def turning_values(kind: Kind, sampling: str) -> tuple[int, ...]:
    """The indices of a kind's parameters on which differentiated sampled directions depend."""
    return kind.steering if sampling == "attached" else kind.bending if sampling == "hybrid" else ()


def sample(material: Material, wi: Vec3, choice: Tensor | None, u: Tensor, v: Tensor, sampling: str,
           ideal: bool = False) -> BSDFSample:
    """Samples a direction from the BSDF. The choice of a lobe never carries a derivative.

    Args:
        choice, u, v: (N,) uniform numbers, the first for the lobe (None: `kind` is not `discrete`).
        sampling: which directions carry derivatives: "attached" all, "hybrid" those of delta lobes and of kinds that it
            follows, "detached" none.
        ideal: sample delta lobes alone, if the kind knows their probability.
    """
    kind, values = material.kind, material.values
    sampling = sampling_at(kind, sampling)
    lobe = chosen_lobe(material, wi, choice, u, v, ideal)
    if followed(kind, sampling):
        wo = kind.sample(values, wi, lobe, u, v)
        if sampling == "hybrid" and kind.smooth:
            wo = where(lobe.delta, wo, wo.detach())
    else:
        wo = kind.sample(material.detach().values, wi, lobe, u, v).detach()
    if not kind.smooth:
        return specular(material, wi, wo, lobe)
    value, pdf = evaluate(material, wi, wo)
    density = pdf.detach()
    if sampling == "attached":
        density = kind.eval_pdf(values, wi, wo, fixed_lobes=True)[1] if kind.discrete else pdf
        density = density * relative_chance(material, wi, wo, lobe)
    else:
        pdf = density
    glossy = BSDFSample(wo, value * density.clamp_min(LEAST_DENSITY).reciprocal(), pdf)
    if not kind.delta:
        return glossy
    mirror = specular(material, wi, wo, lobe)
    return BSDFSample(wo, where(lobe.delta, mirror.weight, glossy.weight), torch.where(lobe.delta, mirror.pdf, glossy.pdf))


def chosen_lobe(material: Material, wi: Vec3, choice: Tensor | None, u: Tensor, v: Tensor, ideal: bool) -> LobeChoice:
    """Selects the BSDF lobe that is sampled; args as for `sample`."""
    kind, values, wi = material.kind, values_for_choice(material.values), wi.map(settled)
    chance = kind.chance_of_delta(values, wi) if ideal else None
    if chance is None:
        return kind.choose(values, wi, choice, u, v)
    lobe = kind.choose(values, wi, choice * chance, u, v)
    return lobe._replace(probability=lobe.probability / chance)


def relative_chance(material: Material, wi: Vec3, wo: Vec3, lobe: LobeChoice) -> Tensor | float:
    """A factor of value 1 whose derivative is the relative derivative of 1 / `Kind.chance_by_direction`."""
    chance = material.kind.chance_by_direction(values_for_choice(material.values), wi, wo, lobe)
    if chance is None:
        return 1.0
    chance = chance.clamp_min(LEAST_DENSITY)
    return settled(chance) / chance


def specular(material: Material, wi: Vec3, wo: Vec3, lobe: LobeChoice) -> BSDFSample:
    """The `BSDFSample` for the direction `wo` of a delta lobe."""
    from_lamp = material.normal is not None
    weight = material.kind.specular(material.values, wo if from_lamp else wi, lobe)
    weight = weight * (1.0 / lobe.probability.clamp_min(LEAST_DENSITY))
    if from_lamp:
        spread = material.kind.spread(material.values, wi, lobe)
        weight = weight * (material.turned(wi, wo) * (1.0 if spread is None else spread))
    return BSDFSample(wo, weight, torch.full_like(wo.z, torch.inf))
