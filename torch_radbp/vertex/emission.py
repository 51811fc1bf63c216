"""Emitted radiance where rays meet surfaces and surroundings, and the density with which light sampling would find it."""

from __future__ import annotations

import functools

import torch
from torch import Tensor

from torch_radbp.interface.texture import Place, TextureValue
from torch_radbp.scene.tables.light_choice import LightPick
from torch_radbp.scene.tables.light_kinds import in_lanes_of, rows_of_case, texture_of_light, visible_cases
from torch_radbp.scene.tables.light_tree import Vantage
from torch_radbp.scene.tables.scene_tensors import SceneTensors
from torch_radbp.tensors.differentiated import settled
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.vec import Ray, Vec3, masked, where
from torch_radbp.vertex.interaction import SurfaceInteraction


def vantage(si: SurfaceInteraction) -> Vantage:
    """The reference point of light selection: position and normal of a surface point, detached."""
    return Vantage(si.p.map(settled), si.frame.n.map(settled))


def emitted(scene: SceneTensors, ray: Ray, si: SurfaceInteraction, texture_values: tuple[TextureValue, ...] = ()) -> Vec3:
    """The radiance that surface or environment emits towards the ray's origin; attached to texels, pose and `ray.d`.

    Args:
        scene, ray, si: the scene, the ray and the surface point that it hits.
        texture_values: the values of emitters' network textures at the `emission_places`.
    """
    radiance = emitted_by_surface(scene, si, texture_values)
    if scene.layout.surround is None:
        return radiance
    return where(si.valid, radiance, emitted_by_surround(scene, ray))


def emitted_by_surface(scene: SceneTensors, si: SurfaceInteraction, texture_values: tuple[TextureValue, ...] = ()) -> Vec3:
    """The radiance that the surfaces hit by rays emit towards the rays' origins; 0 for rays that miss. Attached.

    Args as for `emitted`.
    """
    if not scene.layout.visible_surfaces:
        return Vec3.full(si.p.x, 0.0)
    element = si.emitter.clamp_min(0)
    sends = [in_lanes_of(case, case.kind.sends(si.front)) for case in visible_cases(scene, element)]
    emits = si.valid & functools.reduce(torch.logical_or, sends) & (si.emitter >= 0)
    # Next-event estimation finds the same point by no cone: emitters look the same however they are found.
    point = si.point._replace(uv=si.point.uv if scene.layout.radiance_bitmaps else None, footprint=None)
    return masked(emits, texture_of_light(scene, element, si.p, point, texture_values))


def emission_places(scene: SceneTensors, si: SurfaceInteraction) -> tuple[Place, ...]:
    """The points where rays hit emitters, at which emitters' network textures are evaluated; attached as `si` is."""
    def row(rows: Tensor) -> Tensor:
        if si.emitter is None:
            return torch.full_like(si.prim, -1)
        return torch.where(si.valid & (si.emitter >= 0), lookup(rows, si.emitter.clamp_min(0)), -1)

    return tuple(Place(row(rows), reader.place(si.p, si.point.uv))
                 for reader, rows in zip(scene.layout.lit, scene.lights.outside))


def emitted_by_surround(scene: SceneTensors, ray: Ray) -> Vec3:
    """The radiance of the environment along rays that hit nothing; attached to its parameters and `ray.d`."""
    if scene.layout.surround is None:
        return Vec3.full(ray.d.x, 0.0)
    number, kind = scene.layout.surround
    return kind.radiance(scene.lights.tables[number], ray.d)


def emitted_pdf(scene: SceneTensors, ray: Ray, si: SurfaceInteraction, proposal: SceneTensors | None = None,
                picked: LightPick | None = None) -> Tensor:
    """The solid-angle density with which next-event estimation at the ray's origin would have sampled the point hit.

    For MIS weights only: for the environment it is `SurroundKind.weighing`.

    Args:
        scene: gives geometry.
        ray, si: the ray and the surface point that it hits. The density is attached if these are.
        proposal: gives selection probabilities and the environment; None: `scene`.
        picked: has the probability of selecting the emitter, if it depends on the ray's origin.
    """
    proposal = scene if proposal is None else proposal
    pdf = pdf_of_surface(scene, si, proposal, picked)
    if scene.layout.surround is None:
        return pdf
    return torch.where(si.valid, pdf, pdf_of_surround(proposal, ray))


def pdf_of_surface(scene: SceneTensors, si: SurfaceInteraction, proposal: SceneTensors,
                   picked: LightPick | None = None) -> Tensor:
    """The `emitted_pdf` of rays that hit a surface; 0 for those on surfaces that emit no light."""
    pdf = torch.zeros_like(si.t)
    if not scene.layout.visible_surfaces:
        return pdf
    element = si.emitter.clamp_min(0)
    pmf = lookup(proposal.lights.choice.pmf, element) * (
        (si.emitter >= 0).to(pdf.dtype) if picked is None else picked.chance)
    for case in visible_cases(scene, element):
        row = rows_of_case(scene, element, case)
        density = case.kind.density(scene.lights.tables[case.number], row, pmf, si.t, si.cosine)
        pdf = density if case.mask is None else torch.where(case.mask, density, pdf)
    return pdf


def pdf_of_surround(proposal: SceneTensors, ray: Ray) -> Tensor:
    """The `emitted_pdf` of rays that leave the scene; 0 without an environment."""
    if proposal.layout.surround is None:
        return torch.zeros_like(ray.d.x)
    number, kind = proposal.layout.surround
    return proposal.lights.surround_pmf * kind.weighing(proposal.lights.tables[number], ray.d)
