"""The differentiable function of one bounce, the same for reverse mode, forward mode and plain autograd."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.path.bounce import cone_after, followed_by, gathered, scattering
from torch_radbp.path.state import Arrival, PathState, Position, Settings
from torch_radbp.raycast.protocol import Hit
from torch_radbp.scene.cone import Cone
from torch_radbp.scene.interaction import Corners
from torch_radbp.scene.outgoing_ray import attached_outgoing_ray
from torch_radbp.scene.tensors import SceneTensors
from torch_radbp.tensors.stage import stage
from torch_radbp.tensors.vec import Ray, Vec3, masked, rows
from torch_radbp.texture.reader import TextureValue

MISS = Hit(-1, 0.0, 0.0, 0.0, 0)


class LocalMap(NamedTuple):
    """The terms of L_k = E_k + F_k L_{k+1}, as functions of the parameters of a bounce."""

    E: Vec3
    F: Vec3
    ray: Ray | None  # ray_{k+1}; None if rays carry no derivatives, or the path ends
    pdf: Tensor | None  # density of its direction
    followed: Tensor | None = None  # see `PathState`
    cone: Cone | None = None  # around ray_{k+1}; None if paths carry none


class Verdict(NamedTuple):
    """The decisions at a bounce that derivatives keep: visibility and survival."""

    visible: Tensor  # (N,) bool: the shadow ray was free
    survives: Tensor  # (N,) bool: the path goes on


def local_map(scene: SceneTensors, proposal: SceneTensors, arrival: Arrival, verdict: Verdict | None, following: Hit | None,
              at: Position, settings: Settings, texture_values: tuple[TextureValue, ...], here: Corners | None = None,
              there: Corners | None = None) -> LocalMap:
    """The local map of a bounce: parameters, and the ray if differentiated, to E_k, F_k and the next ray.

    Args:
        scene, proposal, at, settings, texture_values: as for `bounce`.
        arrival: the lanes, as they are.
        verdict: what was decided; None where nothing is scattered.
        following: what the next ray meets, triangle -1 where it meets nothing or there is none.
        here, there: the corners of the triangles that the ray meets and that the next ray does; None: as the scene has them.
    """
    local = scattering(scene, proposal, arrival, at, settings, texture_values, here)
    if verdict is None:
        return LocalMap(local.Le, local.Le.map(torch.zeros_like), None, None)
    E = gathered(local.Le, local.Ld, verdict.visible)
    if not settings.moving:
        return LocalMap(E, masked(verdict.survives, local.sample.weight * local.thinning), None, None)
    weight, ray = attached_outgoing_ray(scene, local.material, local.si, local.sample, following, settings.sampling, there)
    return LocalMap(E, masked(verdict.survives, weight * local.thinning), ray, local.sample.pdf,
                    followed_by(local.material, arrival.state, settings), cone_after(arrival.state, local))


@stage("scene", "proposal", "arrival")
def attached_vertex(scene: SceneTensors, proposal: SceneTensors, arrival: Arrival, lanes: Tensor, verdict: Verdict,
                    following: Hit, at: Position, settings: Settings,
                    texture_values: tuple[TextureValue, ...]) -> tuple[Vec3, PathState]:
    """E_k and the path states that leave vertices, with all derivatives; without `vantage`, which has none.

    Args:
        arrival: the paths that reach this bounce.
        lanes: (M,) int32, those of them that are computed, in this order.
        following: (M,) what the next rays meet; of no meaning where paths end. The rest is as for `local_map`.
    """
    def where_it_goes_on(found: Tensor | None, otherwise: float) -> Tensor | None:
        return None if found is None else torch.where(verdict.survives, found, otherwise)

    arrival, following = rows(arrival, lanes), Hit(*map(where_it_goes_on, following, MISS))
    local, state = local_map(scene, proposal, arrival, verdict, following, at, settings, texture_values), arrival.state
    return local.E, PathState(local.ray, state.beta * local.F, local.pdf, state.key, state.lane, None, local.followed,
                              local.cone)
