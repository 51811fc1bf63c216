"""Light samples as viewpoints from which edges are sampled."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.eye.eyes import Eyes, Lobe, lobe_around
from torch_radbp.boundary.eye.seen_edges import salted
from torch_radbp.call.view import View
from torch_radbp.connection.light import Aims, light_aims
from torch_radbp.path.direct_light import LightDraw
from torch_radbp.path.light_connection import light_numbers
from torch_radbp.sampling.alias import AliasTable
from torch_radbp.sampling.sampler import SampleKey, bounce_key, fine_unit, lane_key, unit
from torch_radbp.scene.tables.light_choice import LightPick, TreeChoice
from torch_radbp.scene.tables.light_kinds import among
from torch_radbp.scene.tables.scene_tensors import SceneTensors
from torch_radbp.tensors.stage import Stages, stage
from torch_radbp.tensors.vec import TINY, Vec3, masked, normalize, rows, where

BEHIND = 0.05  # how much edges count behind a light: interpolated normals may let some light go there
SALT = 0x1F83D9AC  # tells the random numbers of these samples from others


class LightPoints(NamedTuple):
    """M light samples, with the kind of light of each."""

    draw: LightDraw
    kind: Tensor  # (M,) int64, kind of light, index into `Layout.lights`


def light_points(stages: Stages, scene: SceneTensors, view: View, count: int) -> LightPoints:
    """Samples lights with selection probabilities that do not depend on an illuminated point."""
    key, number = salted(view, SALT), torch.arange(count, dtype=torch.int32, device=scene.device)
    return stages(light_samples)(scene.lights.choice, scene.lights.kind, key, number)


@stage("choice", "kind")
def light_samples(choice: AliasTable | TreeChoice, kind: Tensor, key: SampleKey, number: Tensor) -> LightPoints:
    """The light samples with given numbers, (M,) int32.

    Args:
        choice: the distribution of elements of the light table.
        kind: (E,) the kind of light of each element.
        key: of random numbers.
    """
    key = key._replace(shared=torch.full_like(key.shared, -1))
    numbers = light_numbers(bounce_key(lane_key(key, torch.zeros_like(number), number), SALT))
    if isinstance(choice, TreeChoice):
        last = torch.zeros_like(number).long() + choice.last
        emitters = rows(choice.cumulative, last).round()
        emitter = (fine_unit(numbers.choice) * emitters).floor()
        element = torch.searchsorted(choice.cumulative, emitter + fine_unit(numbers.split), right=True)
        element = torch.minimum(element, last).to(torch.int32)
        pmf = rows(choice.pmf, element) / emitters.to(choice.pmf.dtype)
    else:
        element = choice.sample(numbers.choice, unit(numbers.split, choice.pmf.dtype))
        pmf = rows(choice.pmf, element)
    draw = LightDraw(numbers, LightPick(element, pmf, torch.zeros_like(pmf)))
    return LightPoints(draw, rows(kind, element).long())


@stage("scene")
def light_eyes(scene: SceneTensors, draw: LightDraw) -> Eyes:
    """Light samples as viewpoints, (M,); `scene`: detached, any part of it."""
    zero = torch.zeros_like(draw.picked.pmf).double()
    nowhere = Vec3(zero, zero, zero)
    aims = aims_at(scene, nowhere, draw)
    start, d, parallel = line_of(aims, nowhere)
    return Eyes(where(parallel, -d, start), (~parallel).double(), _normal_of(aims, nowhere), zero + BEHIND, zero)


@stage("scene")
def light_lobes(scene: SceneTensors, p: Vec3, draw: LightDraw) -> Lobe:
    """The lights of samples as lobes of directions, seen from given points, one each.

    Args:
        scene: detached, any part of it.
        p: (M,) world, float64.
        draw: (M,) the samples.
    """
    aims = aims_at(scene, p, draw)
    return lobe_around(aims("d"), aims("pdf") / draw.picked.pmf.clamp_min(TINY))


@stage("scene")
def light_line(scene: SceneTensors, p: Vec3, draw: LightDraw) -> tuple[Vec3, Vec3, Tensor]:
    """The lines along which the light of samples passes points p: origin and direction, (N,) world, and parallel, (N,) bool.

    Attached. In parallel light the origin is p itself. The direction is of any length.
    """
    return line_of(aims_at(scene, p, draw), p)


def aims_at(scene: SceneTensors, p: Vec3, draw: LightDraw) -> Aims:
    """The light samples as seen from points p, (N,) world; attached."""
    return light_aims(scene, scene, p.map(lambda c: c.to(scene.dtype)), draw.numbers, draw.picked)


def line_of(aims: Aims, p: Vec3) -> tuple[Vec3, Vec3, Tensor]:
    """The lines along which the light of samples passes p, as of `light_line`; `aims`: the samples as seen from p."""
    parallel = among(aims.cases, [case.kind.parallel for case in aims.cases], aims.element)
    target, towards = (aims(name) for name in ("target", "d"))
    target = p if target is None else target.map(torch.Tensor.double)
    parallel = torch.zeros_like(aims.element, dtype=torch.bool) if parallel is None else parallel
    return where(parallel, p, target), where(parallel, -towards.map(torch.Tensor.double), p - target), parallel


def _normal_of(aims: Aims, p: Vec3) -> Vec3:
    """The surface normals of light samples, (N,) unit, world; 0 for lights without a surface."""
    n = aims("n")
    if n is None:
        return p * 0.0
    known = among(aims.cases, [aim.n is not None for aim in aims.of_case], aims.element)
    return masked(known, normalize(n.map(torch.Tensor.double)))
