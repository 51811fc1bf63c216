"""Light sampling for next-event estimation, over all kinds of lights of a scene."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.interface.emitter import Aim, Pick
from torch_radbp.interface.texture import Place, TexturePoint, TextureValue
from torch_radbp.sampling.sampler import unit
from torch_radbp.scene.tables.light_choice import LightNumbers, LightPick
from torch_radbp.scene.tables.light_kinds import Case, among, light_cases, merged_by_case, rows_of_case, texture_of_light
from torch_radbp.scene.tables.scene_tensors import SceneTensors
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.vec import TINY, Ray, Vec2, Vec3, dot, where

SHADOW_SHORTENING = 1.0 - 1e-3  # a shadow ray ends just before its light
FAR = 1e10  # the distance of the surround


class LightSample(NamedTuple):
    """A sampled point on a light for each lane, as seen from a reference point; attached to both."""

    d: Vec3  # unit direction towards it; fixed for the environment
    radiance: Vec3  # that it sends back (for a light without extent: intensity / distance^2, or irradiance)
    pdf: Tensor  # density over solid angle; probability for a light without extent; 0: cannot be used
    weighing: Tensor  # density for the weights of multiple importance sampling, in place of `pdf`
    findable: Tensor | float  # 1: BSDF sampling can find it too; 0: it cannot (a delta light)
    target: Vec3  # the point, world space
    distant: Tensor | None  # bool: it is a direction rather than a point; None: it never is
    film: Vec2 | None = None  # where on the window, pixels, if the light is the camera: see `connection/camera.py`


class Aims(NamedTuple):
    """Sampled points on lights, (N,), as each kind of light has computed them."""

    element: Tensor  # int32
    cases: list[Case]
    of_case: list[Aim]
    p: Vec3  # the points, world space; for lights without position the reference point

    def __call__(self, name: str):
        """One field of `Aim`, merged from all kinds of lights by the kind of each lane; None: no kind has it."""
        return merged_by_case(self.cases, [getattr(aim, name) for aim in self.of_case])


def light_aims(scene: SceneTensors, proposal: SceneTensors, reference: Vec3, numbers: LightNumbers,
               picked: LightPick | None = None) -> Aims:
    """Selects a light and samples a point on it, without radiance. Args as for `sample_light`."""
    lights = proposal.lights
    if picked is None:
        element = lights.choice.sample(numbers.choice, unit(numbers.split, reference.x.dtype))
        pmf = lookup(lights.choice.pmf, element)
    else:
        element, pmf = picked.element, picked.pmf

    # Let each kind of light that there is decide where to look.
    cases = light_cases(scene, element, dict(enumerate(scene.layout.lights)))
    aims = [case.kind.aim(scene.lights.tables[case.number], lights.tables[case.number], reference,
                          Pick(rows_of_case(scene, element, case), pmf, numbers.u, numbers.v)) for case in cases]
    target = merged_by_case(cases, [aim.target for aim in aims])
    return Aims(element, cases, aims, reference if target is None else target)


def sample_places(scene: SceneTensors, aims: Aims) -> tuple[Place, ...]:
    """The sampled points on lights, at which emitters' network textures are evaluated; attached."""
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
        reference: (N,) world positions of the illuminated points, attached or not.
        numbers: the random numbers.
        picked: the element, if it has been selected before.
        texture_values: the values of emitters' network textures at the `sample_places`.
    """
    samples = light_aims(scene, proposal, reference, numbers, picked)
    element, cases, aims, target = samples
    d, pdf = samples("d"), samples("pdf")
    weighing = pdf
    if any(aim.weighing is not None for aim in aims):
        weighing = merged_by_case(cases, [aim.pdf if aim.weighing is None else aim.weighing for aim in aims])

    # Look up what is sent from there.
    delta, distant = (among(cases, [getattr(case.kind, name) for case in cases], element) for name in ("delta", "distant"))
    findable = 1.0 if delta is None else (~delta).to(pdf.dtype)
    film = samples("uv") if scene.layout.from_lamps else None
    return LightSample(d, sent(scene, samples, texture_values), pdf, weighing, findable, target, distant, film)


def sent(scene: SceneTensors, samples: Aims, texture_values: tuple[TextureValue, ...]) -> Vec3:
    """The radiance of light samples: a texture times a factor, or what the kind of light has computed."""
    element, cases, aims, p = samples
    computed = samples("radiance")
    if all(aim.radiance is not None for aim in aims):
        return computed
    uv = samples("uv") if scene.layout.radiance_bitmaps else None
    point = TexturePoint(uv, dict(zip(scene.layout.radiance.attributes, samples("attributes") or ())))
    radiance = texture_of_light(scene, element, p, point, texture_values)
    if any(aim.strength is not None for aim in aims):
        radiance = radiance * merged_by_case(cases, [strength(aim) for aim in aims])
    if computed is None:
        return radiance
    return where(among(cases, [aim.radiance is not None for aim in aims], element), computed, radiance)


def strength(aim: Aim) -> Tensor | None:
    """The factor by which a light multiplies its texture; None for lights without texture."""
    return torch.ones_like(aim.pdf) if aim.strength is None and aim.radiance is None else aim.strength


def connection_of(start: Vec3, light: LightSample) -> tuple[Ray, Tensor]:
    """The ray from a point to a light sample, and its length, attached to both."""
    reach = light.target - start
    length = torch.sqrt(dot(reach, reach).clamp_min(TINY))
    if light.distant is not None:
        length = torch.where(light.distant, FAR, length)
    return Ray(start, light.d), length


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
