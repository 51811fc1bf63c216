"""The differentiable function of one bounce, the same for reverse mode, forward mode and plain autograd."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.connection.light import connection_of, shadow_ray
from torch_radbp.interface.texture import TextureValue
from torch_radbp.path.bounce import gathered
from torch_radbp.path.state import Arrival, PathState, Position, Settings, ShadowWay
from torch_radbp.path.step import Step
from torch_radbp.path.through_media import let_through
from torch_radbp.raycast.protocol import Hit
from torch_radbp.scene.tables.scene_tensors import SceneTensors
from torch_radbp.scene.tables.triangle_corners import Corners
from torch_radbp.tensors.stage import stage
from torch_radbp.tensors.vec import Vec2, Vec3, masked, rows

MISS = Hit(-1, 0.0, 0.0, 0.0, 0)


class LocalMap(NamedTuple):
    """The terms of L_k = E_k + F_k L_{k+1} and the next ray, as functions of scene parameters and the ray; (N,)."""

    E: Vec3
    F: Vec3
    # The paths that go on, attached: ray_{k+1}, density, cone; None if rays carry no derivatives, or the path ends.
    ahead: PathState | None
    film: Vec2 | None = None  # where the camera sees the vertex, see `LightSample`


class Verdict(NamedTuple):
    """The decisions of a bounce that stay fixed when it is differentiated."""

    visible: Tensor  # (N,) bool: the shadow ray was free
    survives: Tensor  # (N,) bool: the path goes on
    shadow_way: ShadowWay | None = None  # (N,) see `Step`
    following: Hit | None = None  # what the next ray meets, triangle -1: nothing; None: rays carry no derivatives


def verdict_of(step: Step) -> Verdict:
    """The decisions of a step at the vertices that scatter."""
    return Verdict(step.visible, step.survives, step.shadow_way)


class BothCorners(NamedTuple):
    """The corners of the triangles that a ray and the next one meet, to which two bounces contribute derivatives."""

    here: Corners  # of the triangle that the ray meets
    there: Corners | None  # of that which the next ray meets; None: as the scene has them


def local_map(scene: SceneTensors, proposal: SceneTensors, arrival: Arrival, verdict: Verdict | None, at: Position,
              settings: Settings, texture_values: tuple[TextureValue, ...], corners: BothCorners | None = None) -> LocalMap:
    """The local map of a bounce: from scene parameters, and the ray if differentiated, to E_k, F_k and the next ray.

    Args:
        scene, proposal, at, settings, texture_values: as for `bounce`.
        arrival: the paths, all of which are computed.
        verdict: the decisions of the bounce; None where nothing is scattered.
        corners: of the triangles; None: as the scene has them.
    """
    kind, state = scene.layout.vertex, arrival.state
    here, there = corners or (None, None)
    terms = kind.terms(scene, proposal, arrival, at, settings, texture_values, here)
    if verdict is None:
        return LocalMap(terms.Le, terms.Le.map(torch.zeros_like), None)
    Ld = terms.Ld
    if verdict.shadow_way is not None and terms.light is not None:
        o = kind.origin(terms, terms.light.d.detach())
        shadow, length = connection_of(o, terms.light) if settings.moving else shadow_ray(o, terms.light)
        Ld = let_through(scene, Ld, shadow, length, verdict.shadow_way)
    E = gathered(terms.Le, Ld, verdict.visible)
    if settings.ends:
        return LocalMap(E, E.map(torch.zeros_like), None, terms.film(scene))
    if not settings.moving:
        return LocalMap(E, masked(verdict.survives, terms.weight * terms.thinning), None)
    weight, ray = kind.attached_ray(scene, terms, verdict.following, settings.sampling, there)
    F = masked(verdict.survives, weight * terms.thinning)
    return LocalMap(E, F, kind.ahead(terms, state, ray, state.beta * F, settings), terms.film(scene))


@stage("scene", "proposal", "arrival")
def attached_vertex(scene: SceneTensors, proposal: SceneTensors, arrival: Arrival, lanes: Tensor, verdict: Verdict,
                    at: Position, settings: Settings,
                    texture_values: tuple[TextureValue, ...]) -> tuple[Vec3, PathState, Vec2 | None]:
    """E_k, the path states that leave vertices, and along paths from lamps the film positions of vertices, with all
    derivatives; without `vantage`, which has none.

    Args:
        arrival: the paths that reach this bounce.
        lanes: (M,) int32, the paths among these that are computed.
        verdict: (M,) the decisions; `following` is undefined where paths end. The rest is as for `local_map`.
    """
    def where_it_goes_on(hit: Tensor | None, otherwise: float) -> Tensor | None:
        return None if hit is None else torch.where(verdict.survives, hit, otherwise)

    verdict = verdict._replace(following=Hit(*map(where_it_goes_on, verdict.following, MISS)))
    arrival = rows(arrival, lanes)
    local = local_map(scene, proposal, arrival, verdict, at, settings, texture_values)
    return local.E, arrival.state if local.ahead is None else local.ahead, local.film
