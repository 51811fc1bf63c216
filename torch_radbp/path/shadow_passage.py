"""The ways of connections to lights through media: over boundaries and all that lets light pass straight, to the light.

On a way nothing scatters, so that the whole light of a connection counts by what media and surfaces let through.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.connection.light import FAR
from torch_radbp.interface.medium import MediumWay, Tracking
from torch_radbp.path.panes import no_panes, pane_at, with_pane
from torch_radbp.path.passage import (
    NEXT_SEGMENT,
    SALT,
    Segment,
    in_enclosed,
    medium_beyond,
    next_seed,
    steps_seed,
    ways_at_first,
    with_segment,
)
from torch_radbp.path.state import PanesPassed, Position
from torch_radbp.raycast.protocol import Hit
from torch_radbp.sampling.sampler import LaneKey, bounce_key
from torch_radbp.scene.tables.scene_tensors import SceneTensors
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.stage import stage
from torch_radbp.tensors.vec import Ray, dot, rows
from torch_radbp.vertex.interaction import surface_interaction


class ShadowPassage(NamedTuple):
    """The state of shadow rays that pass through media, (N,) each, at the start of a segment between two boundaries."""

    ahead: Ray  # how they go on from there
    medium: Tensor  # int32, number of that in which they are; -1: none
    seed: Tensor  # int32, of the random numbers of steps
    free: Tensor  # bool: nothing has blocked them so far
    ways: tuple[MediumWay, ...]  # in each of `Layout.media`
    panes: PanesPassed | None  # see `ShadowWay`


@stage("scene")
def shadow_begun(scene: SceneTensors, shadow: Ray, distance: Tensor, medium: Tensor, key: LaneKey,
                 at: Position) -> tuple[ShadowPassage, Tensor]:
    """The initial passages of shadow rays through media, and whether there is a shadow ray, (N,) bool.

    Args:
        scene: detached; any part of it.
        shadow, distance: (N,) the rays; distance 0: no ray.
        medium: (N,) int32, numbers of the media in which they begin.
        key: of the paths.
        at: the depth.
    """
    seed, none = steps_seed(bounce_key(key, at.counter + SALT + NEXT_SEGMENT)), torch.zeros_like(distance)
    return ShadowPassage(shadow, medium, seed, none < 1.0, ways_at_first(scene, none), no_panes(scene, none)), distance > 0


@stage("scene", "shadow", "distance", "passed")
def next_shadow_segment(scene: SceneTensors, shadow: Ray, distance: Tensor, passed: ShadowPassage, hit: Hit,
                    tracking: Tracking | None, lanes: Tensor) -> tuple[ShadowPassage, Tensor]:
    """Follows shadow rays through one segment: to the light, to a surface that blocks them, or through a boundary.

    Args:
        scene: detached; any part of it.
        shadow, distance: (N,) the rays from their first origins, and their lengths.
        passed: (N,) the passages so far.
        hit: (M,) what the rays `passed.ahead` hit.
        tracking: (M,) the result of delta tracking; None: no medium is heterogeneous.
        lanes: (M,) int32, the rays that are followed.

    Returns:
        (M,) passages, and whether rays go on behind a boundary.
    """
    shadow, distance, passed = rows((shadow, distance, passed), lanes)
    si, come = surface_interaction(scene, passed.ahead, hit), dot(passed.ahead.o - shadow.o, shadow.d)
    surface, left = dot(si.p - passed.ahead.o, shadow.d), distance - come
    met = (hit.prim >= 0) & (surface < left)
    length = in_enclosed(scene, passed.medium, met, torch.where(met, surface, left).clamp_min(0.0))
    ways = with_segment(scene, passed.ways, passed.medium, Segment(passed.ahead, come, length, length, tracking))
    passes, panes = lookup(scene.boundaries.invisible, lookup(scene.triangles.boundary, si.prim)), passed.panes
    seed = next_seed(passed.seed, tracking)
    if panes is not None:
        pane = pane_at(scene, shadow, hit)
        passes_pane = met & (pane.chance > 0)
        seed, panes = with_pane(panes, hit, pane.through, passes_pane, seed)
        passes = passes | passes_pane
    passes = met & passes
    medium = torch.where(passes, medium_beyond(scene, si.prim, si.cosine, passed.medium), passed.medium)
    return ShadowPassage(Ray(si.offset(shadow.d), shadow.d), medium, seed, ~met, ways, panes), passes


@stage("scene", "shadow", "distance", "ahead")
def shadow_ahead(scene: SceneTensors, shadow: Ray, distance: Tensor, ahead: Ray, hit: Hit, lanes: Tensor) -> Tensor:
    """The lengths of the next segments of shadow rays `ahead`, (M,); other args as for `next_shadow_segment`."""
    shadow, distance, ahead = rows((shadow, distance, ahead), lanes)
    left = distance - dot(ahead.o - shadow.o, ahead.d)
    surface = torch.where(hit.prim >= 0, dot(surface_interaction(scene, ahead, hit).p - ahead.o, ahead.d), FAR)
    return torch.minimum(left, surface).clamp_min(0.0)
