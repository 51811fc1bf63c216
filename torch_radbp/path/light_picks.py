"""Which light next-event estimation connects a vertex to, where that depends on the place."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_radbp.jit.order import chosen
from torch_radbp.path.event import Ends
from torch_radbp.path.flight import flight_vantage
from torch_radbp.path.integrand import Integrand
from torch_radbp.path.lanes import put_rows
from torch_radbp.path.light_connection import light_numbers
from torch_radbp.path.state import Arrival, Flight, PathState, Position, Settings
from torch_radbp.path.surface import surface_met
from torch_radbp.raycast.protocol import Hit
from torch_radbp.sampling.sampler import bounce_key
from torch_radbp.scene.tables.light_choice import LightPick, TreeChoice, chance_of_emitter, drawn_element
from torch_radbp.scene.tables.light_tree import Vantage
from torch_radbp.scene.tables.scene_tensors import SceneTensors
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.stage import stage
from torch_radbp.tensors.vec import rows, where
from torch_radbp.vertex.emission import vantage


@stage("scene", "choice")
def pick_light(scene: SceneTensors, choice: TreeChoice, arrival: Arrival, at: Position) -> tuple[Tensor, Tensor]:
    """Selects lights for next-event estimation by the light tree, with their probabilities.

    Args:
        scene: detached; any part of it.
        choice: the scene's light tree.
        arrival: the paths that reach a bounce.
        at: the depth of the bounce.
    """
    seen = vantage(surface_met(scene, arrival, Settings()))
    if arrival.flight is not None:
        ends, there = arrival.flight.t < torch.inf, flight_vantage(arrival)
        seen = Vantage(*(where(ends, inside, outside) for inside, outside in zip(there, seen)))
    return drawn_element(choice, seen, light_numbers(bounce_key(arrival.state.key, at.counter)))


@stage("scene")
def emitter_met(scene: SceneTensors, hit: Hit) -> tuple[Tensor, LightPick]:
    """(N,) bool: rays that hit an emitter; and the record of the lights that N lanes select, none so far.

    Args:
        scene: detached; any part of it.
        hit: (N,).
    """
    zero = torch.zeros_like(hit.t)
    lit = (hit.prim >= 0) & (lookup(scene.triangles.emitter, hit.prim.clamp_min(0)) >= 0)
    return lit, LightPick(torch.zeros_like(hit.prim), zero, zero)


@stage("scene", "choice", "arrival")
def chance_of_light(scene: SceneTensors, choice: TreeChoice, arrival: Arrival, lanes: Tensor) -> Tensor:
    """The probability of selecting the emitter that each path has hit, (M,). Args as for `pick_light` and `bounce`."""
    state, hit = rows((arrival.state, arrival.hit), lanes)
    return chance_of_emitter(choice, state.vantage, lookup(scene.triangles.emitter, hit.prim))


def picked_lights(integrand: Integrand, state: PathState, hit: Hit, depth: int,
                  flight: Flight | None = None) -> LightPick | None:
    """Selects a light for each path's vertex by the light tree; None if that is not used. `flight`: see `Arrival`."""
    choice = integrand.proposal.lights.choice
    if not integrand.settings.nee or not integrand.proposal.lights.by_place:
        return None
    part, arrival = integrand.part(Ends.SURROUNDINGS), Arrival(state, hit, None, None, flight)
    lit, none = part.call(emitter_met, hit)
    if depth > 0 and len(lanes := chosen(lit)):
        put_rows((none.chance,), lanes, (part.call(chance_of_light, choice, arrival, lanes),))
    if integrand.is_last(depth):
        return none
    return LightPick(*part.call(pick_light, choice, arrival, integrand.at(depth)), none.chance)
