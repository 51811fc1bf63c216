"""What a bounce is told: the integrand's settings, its place on the path, and the paths that reach it."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.jit.lane_count import LaneCount, waited_for
from torch_radbp.raycast.protocol import Hit
from torch_radbp.sampling.sampler import LaneKey
from torch_radbp.scene.cone import Cone
from torch_radbp.scene.light_choice import LightPick
from torch_radbp.scene.light_tree import Vantage
from torch_radbp.tensors.differentiated import settled
from torch_radbp.tensors.record import rows_between
from torch_radbp.tensors.vec import Ray, Vec3


class Settings(NamedTuple):
    """The static settings of the integrand, compiled in."""

    nee: bool = True
    hide_emitters: bool = False  # at this bounce
    moving: bool = False  # rays carry derivatives
    sampling: str = "detached"  # if they do, which go through the choice of directions: "detached", "hybrid", "attached"
    following: bool = False  # states say whether hybrid sampling has followed a direction of a smooth lobe
    shown: bool = True  # vertices tell Le, Ld and F, not only where paths go


class Position(NamedTuple):
    """The place of a bounce on its path: () tensors, so that one compiled function serves every bounce."""

    counter: Tensor  # int32, of the random numbers of this depth
    least_survival: Tensor  # bounds of the probability of surviving roulette; both 1 before `rr_depth`
    most_survival: Tensor


class PathState(NamedTuple):
    """All that a bounce needs to know of the path so far, per lane; what a schedule keeps."""

    ray: Ray
    beta: Vec3  # throughput
    pdf: Tensor  # density over solid angle of the ray's direction; infinite: not left to chance
    key: LaneKey  # of the lane's random numbers
    lane: Tensor  # int32, the lane's place in its chunk; dead lanes leave, so that places have gaps
    vantage: Vantage | None = None  # where the ray begins; None if no light is picked with regard to that
    followed: Tensor | None = None  # bool, see `Settings.following`; None without it
    cone: Cone | None = None  # around the ray; None if no texture asks how much of a surface a sample sees
    number: LaneCount | None = None  # of the lanes, of which the first are meant; None: all are

    @property
    def count(self) -> int | LaneCount:
        """The number of lanes."""
        return len(self.lane) if self.number is None else self.number

    def cut_to_count(self) -> PathState:
        """The same state of as many lanes as there are; waits for the device if it alone knows their number."""
        return self if self.number is None else rows_between(self._replace(number=None), 0, waited_for(self.number))


class Arrival(NamedTuple):
    """The paths that reach a bounce, and what they meet, (N,) each."""

    state: PathState
    hit: Hit
    front: Tensor | None  # bool: they meet the side of the shading normal, where that tells appearances apart; None: nowhere
    picked: LightPick | None = None  # None: lights are picked by probabilities that are the same everywhere


def start_path(ray: Ray, key: LaneKey, from_places: bool = False, following: bool = False,
               cone: Cone | None = None) -> PathState:
    """The state before the first bounce: throughput 1, every lane in its place.

    Args:
        ray, key, cone: of each lane.
        from_places: paths remember where their rays begin.
        following: as in `Settings`.
    """
    beta = Vec3(torch.ones_like(ray.d.x), torch.ones_like(ray.d.x), torch.ones_like(ray.d.x))
    lane = torch.arange(len(ray.d.x), dtype=torch.int32, device=ray.d.x.device)
    return PathState(ray, beta, torch.full_like(ray.d.x, torch.inf), key, lane,
                     Vantage(ray.o.map(settled), ray.d.map(settled)) if from_places else None,
                     torch.zeros_like(lane, dtype=torch.bool) if following else None, cone)
