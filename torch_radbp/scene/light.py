"""Emitted radiance, and light sampling for next-event estimation, over all kinds of lights of a scene."""

from __future__ import annotations

import functools
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.emitter.kind import Aim, LightKind, Pick
from torch_radbp.sampling.sampler import unit
from torch_radbp.scene.interaction import SurfaceInteraction
from torch_radbp.scene.light_choice import LightNumbers, LightPick
from torch_radbp.scene.light_tree import Vantage
from torch_radbp.scene.tensors import SceneTensors
from torch_radbp.tensors.differentiated import settled
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.vec import TINY, Ray, Vec3, dot, masked, where
from torch_radbp.texture.reader import Place, TexturePoint, TextureValue

SHADOW_SHORTENING = 1.0 - 1e-3  # a shadow ray ends just before its light
FAR = 1e10  # the distance of the surround


class LightSample(NamedTuple):
    """A sampled point on a light per lane, as seen from a reference point; attached to both."""

    d: Vec3  # unit direction towards it; fixed for the environment
    radiance: Vec3  # that it sends back (for a light without extent: intensity / distance^2, or irradiance)
    pdf: Tensor  # density over solid angle; probability for a light without extent; 0: cannot be used
    weighing: Tensor  # density for the weights of multiple importance sampling, in place of `pdf`
    findable: Tensor | float  # 1: BSDF sampling can find it too; 0: it cannot (a delta light)
    target: Vec3  # the point, world space
    distant: Tensor | None  # bool: it is a direction rather than a point; None: it never is


def vantage(si: SurfaceInteraction) -> Vantage:
    """The position and normal that light selection depends on, detached: the choice of a light is discrete."""
    return Vantage(si.p.map(settled), si.frame.n.map(settled))


class Case(NamedTuple):
    """One kind of light among those of a scene, and the lanes that have it."""

    number: int  # in `Layout.lights`
    kind: LightKind
    mask: Tensor | None  # (N,) bool: the lanes that it concerns; None: all


def _cases(scene: SceneTensors, element: Tensor, kinds: dict[int, LightKind]) -> list[Case]:
    """The kinds of light that elements of the light table may have."""
    if len(kinds) == 1:
        return [Case(*item, None) for item in kinds.items()]
    which = lookup(scene.lights.kind, element)
    return [Case(number, kind, which == number) for number, kind in kinds.items()]


def visible_cases(scene: SceneTensors, element: Tensor) -> list[Case]:
    """The kinds of light that triangles in the light table may have which are visible emitters."""
    return [case for case in _cases(scene, element, scene.layout.surface_lights) if not case.kind.delta]


def _rows_of(scene: SceneTensors, element: Tensor, case: Case) -> Tensor:
    """The rows of elements in the table of one kind of light; 0 for elements of another kind."""
    if case.mask is None:
        return element  # those of one kind come in the order of its table
    return torch.where(case.mask, lookup(scene.lights.row, element), 0)


def emitted(scene: SceneTensors, ray: Ray, si: SurfaceInteraction, texture_values: tuple[TextureValue, ...] = ()) -> Vec3:
    """The radiance that surface or environment emits towards the ray's origin; attached to texels, pose and `ray.d`.

    Args:
        scene, ray, si: what the ray meets.
        texture_values: the values of emitters' textures that are read outside, at the `emission_places`.
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
    sends = [_in_lanes_of(case, case.kind.sends(si.front)) for case in visible_cases(scene, element)]
    emits = si.valid & functools.reduce(torch.logical_or, sends) & (si.emitter >= 0)
    # Next-event estimation finds the same point by no cone: emitters look the same however they are found.
    point = si.point._replace(uv=si.point.uv if scene.layout.radiance_bitmaps else None, footprint=None)
    return masked(emits, texture_of_light(scene, element, si.p, point, texture_values))


def texture_of_light(scene: SceneTensors, element: Tensor, p: Vec3, point: TexturePoint,
                     texture_values: tuple[TextureValue, ...]) -> Vec3:
    """The emission textures of elements of the light table, evaluated at points; attached.

    Args:
        scene, element: the elements.
        p: world positions of the points.
        point: the points.
        texture_values: for each of `Layout.lit` its values there.
    """
    value = scene.layout.radiance.read(scene.radiance, lookup(scene.lights.radiance, element), point)
    for reader, rows, outside_value in zip(scene.layout.lit, scene.lights.outside, texture_values):
        value = where(lookup(rows, element) >= 0, outside_value.at(reader.place(p, point.uv)), value)
    return value


def emission_places(scene: SceneTensors, si: SurfaceInteraction) -> tuple[Place, ...]:
    """The points at which emitters' textures are evaluated where rays hit emitters; attached as `si` is."""
    def row(rows: Tensor) -> Tensor:
        if si.emitter is None:
            return torch.full_like(si.prim, -1)
        return torch.where(si.valid & (si.emitter >= 0), lookup(rows, si.emitter.clamp_min(0)), -1)

    return tuple(Place(row(rows), reader.place(si.p, si.point.uv))
                 for reader, rows in zip(scene.layout.lit, scene.lights.outside))


def emitted_by_surround(scene: SceneTensors, ray: Ray) -> Vec3:
    """The radiance of the environment along rays that hit nothing; attached to `ray.d` as well."""
    if scene.layout.surround is None:
        return Vec3.full(ray.d.x, 0.0)
    number, kind = scene.layout.surround
    return kind.radiance(scene.lights.tables[number], ray.d)


def emitted_pdf(scene: SceneTensors, ray: Ray, si: SurfaceInteraction, proposal: SceneTensors | None = None,
                picked: LightPick | None = None) -> Tensor:
    """The solid-angle density with which next-event estimation at the ray's origin would have sampled the point hit.

    For weights only: of the surround it is `SurroundKind.weighing`.

    Args:
        scene: gives geometry.
        ray, si: what the ray meets. The density is attached if these arguments are.
        proposal: gives the probabilities of picking a light, and the surround; None: `scene`.
        picked: has the probability of picking the emitter, if it depends on where that is done.
    """
    proposal = scene if proposal is None else proposal
    pdf = pdf_of_surface(scene, si, proposal, picked)
    if scene.layout.surround is None:
        return pdf
    return torch.where(si.valid, pdf, pdf_of_surround(proposal, ray))


def pdf_of_surface(scene: SceneTensors, si: SurfaceInteraction, proposal: SceneTensors,
                   picked: LightPick | None = None) -> Tensor:
    """`emitted_pdf` for rays that hit a surface."""
    pdf = torch.zeros_like(si.t)
    if not scene.layout.visible_surfaces:
        return pdf
    element = si.emitter.clamp_min(0)
    pmf = lookup(proposal.lights.choice.pmf, element) * (
        (si.emitter >= 0).to(pdf.dtype) if picked is None else picked.chance)
    for case in visible_cases(scene, element):
        row = _rows_of(scene, element, case)
        density = case.kind.density(scene.lights.tables[case.number], row, pmf, si.t, si.cosine)
        pdf = density if case.mask is None else torch.where(case.mask, density, pdf)
    return pdf


def pdf_of_surround(proposal: SceneTensors, ray: Ray) -> Tensor:
    """`emitted_pdf` for rays that leave the scene."""
    if proposal.layout.surround is None:
        return torch.zeros_like(ray.d.x)
    number, kind = proposal.layout.surround
    return proposal.lights.surround_pmf * kind.weighing(proposal.lights.tables[number], ray.d)


class Aims(NamedTuple):
    """Points sampled on lights by each kind of light, (N,)."""

    element: Tensor  # int32
    cases: list[Case]
    of_case: list[Aim]
    p: Vec3  # the points, world space; for lights without position the reference point

    def __call__(self, name: str):
        """One field of the `Aim` of each lane's kind of light; None: no kind has it."""
        return _chosen(self.cases, [getattr(aim, name) for aim in self.of_case])


def light_aims(scene: SceneTensors, proposal: SceneTensors, reference: Vec3, numbers: LightNumbers,
               picked: LightPick | None = None) -> Aims:
    """Selects lights, and points on them. Args as for `sample_light`."""
    lights = proposal.lights
    if picked is None:
        element = lights.choice.sample(numbers.choice, unit(numbers.split, reference.x.dtype))
        pmf = lookup(lights.choice.pmf, element)
    else:
        element, pmf = picked.element, picked.pmf

    # Let each kind of light that there is decide where to look.
    cases = _cases(scene, element, dict(enumerate(scene.layout.lights)))
    aims = [case.kind.aim(scene.lights.tables[case.number], lights.tables[case.number], reference,
                          Pick(_rows_of(scene, element, case), pmf, numbers.u, numbers.v)) for case in cases]
    target = _chosen(cases, [aim.target for aim in aims])
    return Aims(element, cases, aims, reference if target is None else target)


def sample_places(scene: SceneTensors, aims: Aims) -> tuple[Place, ...]:
    """The points at which emitters' textures are evaluated for light samples; attached."""
    uv = aims("uv") if scene.layout.radiance_bitmaps else None
    return tuple(Place(lookup(rows, aims.element), reader.place(aims.p, uv))
                 for reader, rows in zip(scene.layout.lit, scene.lights.outside))


def sample_light(scene: SceneTensors, proposal: SceneTensors, reference: Vec3, numbers: LightNumbers,
                 picked: LightPick | None = None, texture_values: tuple[TextureValue, ...] = ()) -> LightSample:
    """Selects a light and samples a point on it, as seen from a reference point.

    Element and point, or direction, are decided by `proposal`; the point then moves with `scene`.

    Args:
        scene: attached; gives geometry, poses and radiance.
        proposal: detached; gives every choice.
        reference: (N,) world positions of the points where light is wanted, attached or not.
        numbers: decide.
        picked: the element, if that has been decided before.
        texture_values: the values of emitters' textures that are read outside, at the `sample_places`.
    """
    samples = light_aims(scene, proposal, reference, numbers, picked)
    element, cases, aims, target = samples
    d, pdf = samples("d"), samples("pdf")
    weighing = pdf
    if any(aim.weighing is not None for aim in aims):
        weighing = _chosen(cases, [aim.pdf if aim.weighing is None else aim.weighing for aim in aims])

    # Look up what is sent from there.
    delta, distant = (among(cases, [getattr(case.kind, name) for case in cases], element) for name in ("delta", "distant"))
    findable = 1.0 if delta is None else (~delta).to(pdf.dtype)
    return LightSample(d, sent(scene, samples, texture_values), pdf, weighing, findable, target, distant)


def sent(scene: SceneTensors, samples: Aims, texture_values: tuple[TextureValue, ...]) -> Vec3:
    """The radiance of light samples: a texture times its factor, or what the kind of light has computed."""
    element, cases, aims, p = samples
    computed = samples("radiance")
    if all(aim.radiance is not None for aim in aims):
        return computed
    uv = samples("uv") if scene.layout.radiance_bitmaps else None
    point = TexturePoint(uv, dict(zip(scene.layout.radiance.attributes, samples("attributes") or ())))
    radiance = texture_of_light(scene, element, p, point, texture_values)
    if any(aim.strength is not None for aim in aims):
        radiance = radiance * _chosen(cases, [strength(aim) for aim in aims])
    if computed is None:
        return radiance
    return where(among(cases, [aim.radiance is not None for aim in aims], element), computed, radiance)


def strength(aim: Aim) -> Tensor | None:
    """The factor by which a light multiplies its texture; None for lights that read none."""
    return torch.ones_like(aim.pdf) if aim.strength is None and aim.radiance is None else aim.strength


def _chosen(cases: list[Case], values: list):
    """Merges values computed per kind of light by each lane's kind; None (any value will do) only if all are None."""
    result = None
    for case, value in zip(cases, values):
        if result is None:
            result = value
        elif value is not None:
            result = selected(case.mask, value, result)
    return result


def selected(mask: Tensor, a, b):
    """`torch.where` for tensors or records of tensors."""
    if isinstance(a, tuple):
        parts = [selected(mask, *parts) for parts in zip(a, b)]
        return type(a)(*parts) if hasattr(a, "_fields") else tuple(parts)
    return torch.where(mask, a, b)


def _in_lanes_of(case: Case, condition: Tensor) -> Tensor:
    """A condition, (N,) bool, restricted to the lanes of one kind of light."""
    return condition if case.mask is None else case.mask & condition


def among(cases: list[Case], wanted: list[bool], element: Tensor) -> Tensor | None:
    """True in the lanes whose kind of light is wanted, (N,) bool; None if no kind is."""
    if all(wanted):
        return torch.ones_like(element, dtype=torch.bool)
    masks = [case.mask for case, want in zip(cases, wanted) if want]
    return functools.reduce(torch.logical_or, masks) if masks else None


def shadow_ray(start: Vec3, light: LightSample) -> tuple[Ray, Tensor]:
    """The shadow ray to a light sample, and its length; 0 where the sample cannot be used. Detached if `start` is.

    It aims from where it starts, off the surface: with the direction taken from the surface point, a lamp shadows itself.
    """
    d = light.d.detach()
    reach = light.target.detach() - start
    squared = dot(reach, reach)
    shorter = torch.rsqrt(squared.clamp_min(TINY))
    aim, length = reach * shorter, squared * shorter * SHADOW_SHORTENING
    if light.distant is not None:
        aim, length = where(light.distant, d, aim), torch.where(light.distant, FAR, length)
    return Ray(start, aim), length * (light.pdf.detach() > 0).to(length.dtype)
