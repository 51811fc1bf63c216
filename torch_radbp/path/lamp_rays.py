"""The rays of lamps: one for each path that begins at a light, with the power that it carries."""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor

from torch_radbp.connection.light import Aims, sent
from torch_radbp.interface.emitter import Pick, RayNumbers, Surrounding
from torch_radbp.interface.texture import TextureValue
from torch_radbp.path.camera_rays import CameraSample
from torch_radbp.raycast.protocol import Hit
from torch_radbp.sampling.sampler import (
    CAMERA_COUNTER,
    BounceKey,
    SampleKey,
    bounce_key,
    depth_counter,
    fine_unit,
    lane_key,
    random_bits,
    uniform,
    unit,
)
from torch_radbp.scene.tables.light_choice import TreeChoice
from torch_radbp.scene.tables.light_kinds import among, light_cases, merged_by_case, rows_of_case
from torch_radbp.scene.tables.scene_tensors import Layout, LightTable
from torch_radbp.scene.tables.triangle_corners import Corners, edges
from torch_radbp.tensors.differentiated import detached
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.stage import stage
from torch_radbp.tensors.vec import TINY, Ray, Vec2, Vec3, cross, dot
from torch_radbp.vertex.cone import Cone

ACROSS_U, ACROSS_V, POINT_U, POINT_V = range(4)  # the random numbers of a ray
CHOICE, SPLIT, TARGET = range(3)  # and of its lamp, which are those of another point: four are all that a point has
LAMP_COUNTER = int(depth_counter(-2, torch.device("cpu")))


class LampTensors(NamedTuple):
    """The tables of a scene's lights, from which paths from lamps are sampled; attached."""

    lights: LightTable
    radiance: Any  # the bank of `Layout.radiance`
    world: Surrounding
    layout: Layout


class MetFirst(NamedTuple):
    """The triangles that rays from lamps hit first, to which their derivatives may be glued, (N,)."""

    corners: Corners  # of the triangles, world, attached
    hit: Hit


@stage("lamps")
def sample_lamps(lamps: LampTensors, lane: Tensor, key: SampleKey, texture_values: tuple[TextureValue, ...],
                 cones: bool, met: MetFirst | None) -> CameraSample:
    """Samples one ray of light per lane, with its power over the density; attached to the lights.

    Args:
        lamps: the lights.
        lane: (N,) int32, the number of each path.
        key: the key of the rendering's random numbers.
        texture_values: the values of network textures, evaluated beforehand.
        cones: whether rays get ray cones, here of width 0, so that textures are read sharply.
        met: the points to which the rays of kinds that are `aimed` are glued; None: they follow their lamps.
    """
    keys, dtype = lane_key(key, torch.zeros_like(lane), lane), lamps.world.clearance.dtype
    numbers, proposal = bounce_key(keys, CAMERA_COUNTER), detached(lamps)
    of_lamp = bounce_key(keys, LAMP_COUNTER)
    element, pmf = chosen_light(proposal.lights, of_lamp)
    pick_u, pick_v = (random_bits(numbers, dimension) for dimension in (POINT_U, POINT_V))
    across = Vec2(*(uniform(numbers, dimension, dtype) for dimension in (ACROSS_U, ACROSS_V)))
    glued = None if met is None else met.hit.prim >= 0
    point = None if met is None else glued_point(met)
    decide = RayNumbers(across, uniform(of_lamp, TARGET, dtype), point)
    cases = light_cases(lamps, element, dict(enumerate(lamps.layout.lights)))
    rays = [case.kind.emit(lamps.lights.tables[case.number], proposal.lights.tables[case.number],
                           Pick(rows_of_case(lamps, element, case), pmf, pick_u, pick_v), decide, lamps.world)
            for case in cases]
    start = merged_by_case(cases, [ray.target for ray in rays])
    samples = Aims(element, cases, rays, start)
    d, pdf, n = samples("d"), samples("pdf"), samples("n")
    aimed = among(cases, [case.kind.aimed for case in cases], element)
    valid = pdf > 0
    power = sent(lamps, samples, texture_values) * (valid.to(dtype) / torch.where(valid, pdf, 1.0))
    if met is not None and aimed is not None:
        parallel = among(cases, [case.kind.parallel for case in cases], element)
        power = power * torch.where(glued & aimed, area_ahead(met, start, d, parallel), 1.0)
    if n is not None:  # off the surface that it leaves
        start = start + n.map(lambda c: c.detach() * lamps.world.clearance)
    nothing = torch.zeros_like(pdf.detach())
    cone = Cone(nothing, nothing) if cones else None
    return CameraSample(Ray(start, d), keys, None, cone, None, None if aimed is None else ~aimed, power)


def glued_point(met: MetFirst) -> Vec3:
    """Points at fixed barycentric coordinates of triangles, (N,) world, attached to the triangles."""
    p0, e1, e2 = edges(*met.corners)
    return p0 + e1 * met.hit.u.detach() + e2 * met.hit.v.detach()


def area_ahead(met: MetFirst, start: Vec3, d: Vec3, parallel: Tensor | None) -> Tensor:
    """The relative change of the solid angle of triangles as seen from a lamp, as a factor of value 1; attached.

    Args:
        met: the triangles.
        start, d: (N,) the rays, attached.
        parallel: (N,) bool: in parallel light the area across the light counts instead; None: nowhere.
    """
    _, e1, e2 = edges(*met.corners)
    reach = glued_point(met) - start
    element, squared = dot(cross(e1, e2), d), dot(reach, reach).clamp_min(TINY)
    spread = element / (squared if parallel is None else torch.where(parallel, 1.0, squared))
    fixed = spread.detach()
    seen = fixed.abs() > TINY
    return torch.where(seen, spread, 1.0) / torch.where(seen, fixed, 1.0)


def chosen_light(lights: LightTable, numbers: BounceKey) -> tuple[Tensor, Tensor]:
    """Samples elements of the light table for paths that begin at lamps: (N,) int32, and their probabilities."""
    choice, bits, split = lights.choice, random_bits(numbers, CHOICE), random_bits(numbers, SPLIT)
    if not isinstance(choice, TreeChoice):
        element = choice.sample(bits, unit(split, choice.pmf.dtype))
        return element, lookup(choice.pmf, element)
    emitters = choice.cumulative[-1:].round()  # all alike, and its elements by their shares
    emitter = torch.minimum(torch.floor(fine_unit(bits) * emitters), emitters - 1)
    element = torch.searchsorted(choice.cumulative, emitter + fine_unit(split), right=True)
    element = torch.minimum(element, choice.last).to(torch.int32)
    return element, lookup(choice.pmf, element) / emitters.to(choice.pmf.dtype)
