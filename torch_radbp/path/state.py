"""What a bounce depends on: the integrand's settings, its depth, and the paths that reach it."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.interface.medium import MediumWay
from torch_radbp.jit.recording.lane_count import LaneCount, waited_for
from torch_radbp.path.camera_rays import CameraSample
from torch_radbp.raycast.protocol import Hit
from torch_radbp.sampling.sampler import LaneKey
from torch_radbp.scene.tables.light_choice import LightPick
from torch_radbp.scene.tables.light_tree import Vantage
from torch_radbp.tensors.differentiated import settled
from torch_radbp.tensors.record import rows_between
from torch_radbp.tensors.vec import Ray, Vec3
from torch_radbp.vertex.cone import Cone

# The random numbers of one bounce, four coordinates of a point at a time.
BSDF_U, BSDF_V, BSDF_CHOICE, ROULETTE, LIGHT_U, LIGHT_V, LIGHT_CHOICE, LIGHT_SPLIT = range(8)


class Settings(NamedTuple):
    """The static settings of the integrand, which are compiled into stages."""

    nee: bool = True
    hide_emitters: bool = False  # at this bounce
    moving: bool = False  # rays carry derivatives
    sampling: str = "detached"  # if they do, which sampled directions are differentiated: "detached", "hybrid", "attached"
    following: bool = False  # states record whether hybrid sampling has differentiated a direction of a smooth lobe
    shown: bool = True  # vertices have Le and Ld, not only the next path state
    factors: bool = False  # vertices have F, too, which is a part of the next throughput
    ends: bool = False  # at this bounce, though light is scattered to the camera
    ideal: bool = False  # at this bounce delta lobes alone are sampled, where kinds can tell their probability
    fixed_start: bool = False  # nobody asks for derivatives by the rays with which paths begin, which reach this bounce
    # Which light is that of paths that begin at lamps: "camera": none; "caustics": what reaches a vertex that the camera
    # sees by way of an ideal one beside the lamp; "all": what reaches any such vertex. None of it counts twice.
    light_paths: str = "camera"


class Position(NamedTuple):
    """The depth of a bounce on its path: () tensors, so that one compiled function serves every bounce."""

    counter: Tensor  # int32, counter of this depth's random numbers
    least_survival: Tensor  # bounds of the probability of surviving roulette; both 1 before `rr_depth`
    most_survival: Tensor


class PathState(NamedTuple):
    """The state of a path before a bounce, per lane, which checkpoints of the backward pass keep."""

    ray: Ray
    beta: Vec3  # throughput
    pdf: Tensor  # solid-angle density of the ray's direction; infinite: not random; -1: glued to what it meets
    key: LaneKey  # of the lane's random numbers
    lane: Tensor  # int32, index of the lane in its chunk; dead lanes leave gaps
    vantage: Vantage | None = None  # where the ray starts; None if light selection does not depend on it
    followed: Tensor | None = None  # bool, see `Settings.following`; None without it
    cone: Cone | None = None  # around the ray; None if no texture asks how much of a surface a sample sees
    medium: Tensor | None = None  # int32, in which the ray starts, -1: none; None: rays are not followed through media
    first: Tensor | None = None  # int32, how it was scattered first: see `light_share.py`; None: nobody asks
    number: LaneCount | None = None  # of the lanes, of which the first are meant; None: all are

    @property
    def count(self) -> int | LaneCount:
        """The number of lanes."""
        return len(self.lane) if self.number is None else self.number

    def cut_to_count(self) -> PathState:
        """The state without unused lanes; waits for the device if it alone knows the number of lanes."""
        return self if self.number is None else rows_between(self._replace(number=None), 0, waited_for(self.number))


class BoundaryCrossing(NamedTuple):
    """Where rays cross the boundary of a medium, (N,) each; detached."""

    hit: Hit  # as seen from where they began; triangle -1: they pass no more
    before: Tensor  # int32, numbers of the media on both sides; -1: none
    after: Tensor


class PanesPassed(NamedTuple):
    """The panes, surfaces that light passes straight, that rays have passed so far, (N,) each; detached."""

    count: Tensor
    through: Vec3  # the share of light that all of them let through
    picked: Hit  # one of them, picked evenly; triangle -1: none
    others: Vec3  # the share that the others let through


class ShadowWay(NamedTuple):
    """The ways of shadow rays through media and panes, (N,) each; detached."""

    ways: tuple[MediumWay, ...]  # in each of `Layout.media`
    medium: Tensor  # int32, number of that in which they end; -1: none
    panes: PanesPassed | None  # None: the scene has none
    crossings: tuple[BoundaryCrossing, ...] | None = None  # in turn; None: rays carry no derivatives


class EmissionPlace(NamedTuple):
    """A sampled point on each ray through media at which their emission is evaluated, (N,) each; detached."""

    t: Tensor  # distance to it
    medium: Tensor  # int32, number of that in which it is
    weight: Tensor  # by which the light counts that is emitted there and let through: 1 / density over length
    total: Tensor  # of all places of which this was picked, their worth
    ways: tuple[MediumWay, ...]  # to it, in each of `Layout.media`
    panes: PanesPassed | None  # that are passed up to it; None: the scene has none


class Flight(NamedTuple):
    """How far path segments come in media before they scatter, (N,) each; detached."""

    t: Tensor  # distance to where they scatter before they meet a surface; infinite: they do not
    chance: Tensor  # density of this distance over length, or the probability of getting as far as the surface
    # Where rays are followed through media the number of that in which the way ends, int32, -1: none; and the ways in each
    # of `Layout.media`. Else None and nothing: the whole way is in one medium.
    medium: Tensor | None = None
    ways: tuple[MediumWay, ...] = ()
    crossings: tuple[BoundaryCrossing, ...] | None = None  # in turn; None: rays are not followed, or carry no derivatives
    # Where there are `Layout.panes` those that are passed; the probability that the surface at the end is not, and the
    # random number that has decided it, by which its lobe is chosen. Else None.
    panes: PanesPassed | None = None
    stays: Tensor | None = None
    choice: Tensor | None = None
    emission: EmissionPlace | None = None  # None: no medium emits


class Arrival(NamedTuple):
    """The paths that reach a bounce, and what they meet there: surfaces, or a medium before these; (N,) each."""

    state: PathState
    hit: Hit
    front: Tensor | None  # bool: they hit the front, where sides have different appearances; None: nowhere
    picked: LightPick | None = None  # None: lights are selected by constant probabilities
    flight: Flight | None = None  # None: nothing scatters between surfaces


def start_path(sample: CameraSample, from_places: bool = False, following: bool = False, medium: int | None = None,
               shared: bool = False) -> PathState:
    """The state before the first bounce, lanes numbered in order.

    Args:
        sample: (N,) the first rays.
        from_places: paths remember where their rays begin.
        following: as `Settings.following`.
        medium: the number of the medium in which paths begin, -1: none; None: rays are not followed through media.
        shared: some light comes by camera paths, the rest by paths from lamps.
    """
    ray, power, slides = sample.ray, sample.power, sample.slides
    beta = Vec3(torch.ones_like(ray.d.x), torch.ones_like(ray.d.x), torch.ones_like(ray.d.x)) if power is None else power
    lane = torch.arange(len(ray.d.x), dtype=torch.int32, device=ray.d.x.device)
    pdf = torch.full_like(ray.d.x.detach(), torch.inf)
    return PathState(ray, beta, pdf if slides is None else torch.where(slides, pdf, -1.0), sample.key, lane,
                     Vantage(ray.o.map(settled), ray.d.map(settled)) if from_places else None,
                     torch.zeros_like(lane, dtype=torch.bool) if following else None, sample.cone,
                     None if medium is None else torch.full_like(lane, medium), torch.zeros_like(lane) if shared else None)
