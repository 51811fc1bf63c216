"""The loops that follow rays through the boundaries of media, leg by leg; `passage.py` has what happens on one."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_radbp.connection.media import transmittance_of
from torch_radbp.jit.order import chosen, inverted
from torch_radbp.path.bounce import Vertex
from torch_radbp.path.event import Ends
from torch_radbp.path.integrand import Integrand
from torch_radbp.path.lanes import put_rows
from torch_radbp.path.passage import ShadowPassage, free_flight, next_leg, next_shadow_leg, way_begun
from torch_radbp.path.state import Flight, PathState
from torch_radbp.raycast.protocol import Hit
from torch_radbp.scene.tables.scene_tensors import SceneTensors
from torch_radbp.tensors.differentiated import detached
from torch_radbp.tensors.stage import stage
from torch_radbp.tensors.vec import Ray, Vec3, rows

Lengths = tuple[Tensor, ...]  # (N,) each, of the ways in each of `Layout.media`


def free_flights(integrand: Integrand, state: PathState, hit: Hit, depth: int) -> tuple[Hit, Flight | None]:
    """What paths meet behind the boundaries that they pass, and how far they come in media; None: see `Arrival`.

    Args:
        integrand: the scene.
        state, hit: the paths that reach a bounce, and what their rays meet first, (N,).
        depth: of the bounce.
    """
    layout, flies = integrand.proposal.layout, not integrand.is_last(depth)
    if not layout.bounded and not (layout.scattering_media and flies):
        return hit, None
    part, at, state = integrand.part(Ends.SURROUNDINGS), integrand.at(depth), detached(state)
    if not layout.bounded:
        return hit, part.call(free_flight, state, hit, at)
    lanes = torch.arange(len(hit.prim), dtype=torch.int32, device=hit.prim.device)
    hit, way, passes = part.call(next_leg, state.ray, part.call(way_begun, state, at), hit, lanes, flies)
    lanes = chosen(passes)
    while len(lanes):
        beyond = integrand.caster.intersect(rows(way.ahead, lanes))
        *leg, passes = part.call(next_leg, state.ray, way, beyond, lanes, flies)
        put_rows((hit, way), lanes, leg)
        lanes = rows(lanes, chosen(passes))
    return hit, way.flight


def free_connections(integrand: Integrand, vertex: Vertex) -> tuple[Tensor, Lengths | None]:
    """Which shadow rays are free, (N,) bool, and the lengths of their ways in media; None: media have no boundaries."""
    if not integrand.proposal.layout.bounded:
        return inverted(integrand.caster.occluded(vertex.shadow, vertex.shadow_distance)), None
    part, shadow, distance = integrand.part(Ends.SURROUNDINGS), detached(vertex.shadow), vertex.shadow_distance
    passed = passed_at_first(part.proposal, shadow, vertex.shadow_medium)
    lanes = chosen(distance > 0)
    while len(lanes):
        hit = integrand.caster.intersect(rows(passed.ahead, lanes))
        leg, passes = part.call(next_shadow_leg, shadow, distance, passed, hit, lanes)
        put_rows(passed, lanes, leg)
        lanes = rows(lanes, chosen(passes))
    return passed.free, passed.lengths


def passed_at_first(scene: SceneTensors, shadow: Ray, medium: Tensor) -> ShadowPassage:
    """Shadow rays where they begin, in media of these numbers; of tensors that may be written into."""
    come = torch.zeros_like(shadow.d.x)
    return ShadowPassage(Ray(shadow.o.map(Tensor.clone), shadow.d.map(Tensor.clone)), come, medium.clone(),
                  torch.ones_like(medium, dtype=torch.bool), tuple(torch.zeros_like(come) for _ in scene.layout.media))


@stage("scene")
def let_through(scene: SceneTensors, light: Vec3, shadow: Ray, lengths: Lengths) -> Vec3:
    """What media let through of light along connections, (N,), attached to it and to the media.

    Args:
        scene: any part of it.
        light: that comes if nothing is on the way.
        shadow: the connections.
        lengths: of their ways in media.
    """
    return light * transmittance_of(scene, shadow, lengths)
