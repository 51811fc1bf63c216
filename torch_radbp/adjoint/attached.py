"""The loop over bounces with all derivatives, recorded by autograd or in forward mode."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_radbp.adjoint.local_map import attached_vertex, verdict_of
from torch_radbp.jit.dual import dual
from torch_radbp.path.integrand import Integrand
from torch_radbp.path.lanes import put_rows
from torch_radbp.path.queues import Queue
from torch_radbp.path.state import PathState
from torch_radbp.path.step import Onward, Step, surviving
from torch_radbp.path.taped_bounces import Bounce
from torch_radbp.path.texture_networks import texture_values_at
from torch_radbp.path.through_media import free_flights
from torch_radbp.path.trace import Visit, trace
from torch_radbp.path.vertices import room_for_vertices
from torch_radbp.path.wavefront import LightOfBounce, bounced, brighten, take_step
from torch_radbp.raycast.protocol import Hit
from torch_radbp.tensors.differentiated import detached
from torch_radbp.tensors.record import joined, rows_between
from torch_radbp.tensors.stage import EAGER
from torch_radbp.tensors.vec import Ray, Vec2, Vec3, rows
from torch_radbp.threads.team import loops_together


def trace_attached(integrand: Integrand, state: PathState, visit: Visit | None = None) -> Vec3:
    """The radiance L_1 along rays with all derivatives: recorded by autograd, or in forward mode as dual tensors.

    Args as of `trace`.
    """
    return trace(integrand, state, visit, bounce=bounce_attached(integrand))


def bounce_attached(integrand: Integrand) -> Bounce:
    """The function that takes one bounce with all derivatives."""
    return bounced_twice if integrand.settings.moving else bounced


def bounced_twice(integrand: Integrand, onward: Onward, depth: int, L: Vec3 | None) -> tuple[PathState, Step, Onward]:
    """Takes a bounce with differentiated rays: first detached, to find the next hits, then attached to these.

    Args and results as of `bounced`, but that `L` is never None.
    """
    fixed, stages, state = integrand.still(), integrand.stages, onward.packed(integrand)
    vertex, _, step = take_step(fixed, detached(state), depth, hit=onward.hit, flight=onward.flight, with_light=False)
    alive = surviving(step)
    hit = following = None
    if not integrand.is_last(depth):
        ahead = stages(rows)(vertex.next, alive)
        hit = fixed.caster.intersect(ahead.ray)
        following, _ = free_flights(fixed, ahead, hit, depth + 1)
    E, ahead, film = attached_vertices(integrand, state, depth, step, _spread(following, alive, step.scattered))
    if E is not None:
        brighten(integrand, L, state, step.order[:step.scattered], vertex.next.lane, LightOfBounce(E, film=film))
        ahead = ahead._replace(vantage=vertex.next.vantage, medium=vertex.next.medium)
    light = attached_light(integrand, state, depth, step)
    if light is not None:
        order = step.order[step.scattered:]
        brighten(integrand, L, state, order, stages(rows)(state.lane, order), LightOfBounce(light))
    return state, step, Onward(vertex.next if ahead is None else ahead, alive, hit)


def attached_light(integrand: Integrand, state: PathState, depth: int, step: Step) -> Vec3 | None:
    """The emission seen by paths that end at a bounce, with all derivatives; None: no path ends."""
    *_, queue = step.queues
    if queue.event.scatters:
        return None
    return integrand.part(queue.event).evaluate(*arguments_of(integrand, state, depth, step, queue))


def attached_vertices(integrand: Integrand, state: PathState, depth: int, step: Step,
                      following: Hit | None) -> tuple[Vec3 | None, PathState | None, Vec2 | None]:
    """E_k of the vertices that scatter, the path states that leave them, and their film positions, as of `attached_vertex`,
    with all derivatives; None: no path scatters.

    Args:
        step: the decisions of the bounce.
        following: what the next rays hit; None at the last bounce.
    """
    queues = [queue for queue in step.queues if queue.event.scatters]
    if not queues:
        return None, None, None
    stage, verdict = integrand.stages(attached_vertex), verdict_of(step)._replace(following=following)
    prepared = [(scene, proposal, reached, lanes, rows_between(verdict, queue.first, queue.last), *more)
                for queue in queues
                for scene, proposal, reached, lanes, *more in [arguments_of(integrand, state, depth, step, queue)]]
    if len(queues) == 1 or not stage.is_compiled:
        return joined([stage(*of_queue) for of_queue in prepared])
    room = room_for_paths(integrand, state, step.scattered)
    with loops_together():
        for queue, of_queue in zip(queues, prepared):
            stage.into(room, queue.first, *of_queue)
    return room


def arguments_of(integrand: Integrand, state: PathState, depth: int, step: Step, queue: Queue) -> tuple:
    """The arguments of the stages of a bounce for the lanes of one queue, attached."""
    part, lanes = integrand.part(queue.event), step.order[queue.first:queue.last]
    arrival, at, settings, values = step.arrival(state), integrand.at(depth), integrand.settings_at(depth), ()
    if integrand.proposal.layout.reads_outside:
        places = queue.event.vertex.places(part.scene, part.proposal, rows(arrival, lanes), at, settings)
        values = texture_values_at(integrand.scene, integrand.scatterer(queue.event), places)
    return part.scene, part.proposal, arrival, lanes, at, settings, values


def room_for_paths(integrand: Integrand, state: PathState, lanes: int) -> tuple[Vec3, PathState, Vec2 | None]:
    """Uninitialised E_k, path states and film positions of a bounce, dual tensors, for `attached_vertices` to write into."""
    from_lamps = integrand.proposal.layout.from_lamps
    values, tangents = (room_for_vertices(state, lanes, True, False, from_lamps) for _ in range(2))
    film = dual(values.film, tangents.film) if from_lamps else None
    E, ahead = dual(values.Le, tangents.Le), values.next._replace(vantage=None)
    settings, of = integrand.settings, tangents.next
    pdf = dual(ahead.pdf, of.pdf) if settings.sampling == "attached" or settings.following else ahead.pdf
    cone = None if ahead.cone is None else dual(ahead.cone, of.cone)
    return E, ahead._replace(ray=dual(ahead.ray, of.ray), beta=dual(ahead.beta, of.beta), pdf=pdf, cone=cone), film


def rays_reaching(integrand: Integrand, start: PathState, depth: Tensor) -> Ray:
    """The rays that reach the vertices of paths at given depths, with all derivatives.

    Args:
        integrand: attached.
        start: (N,) the states at the start of the paths, attached.
        depth: (N,) int64, less than the number of vertices of each path.
    """
    rays, lanes = [], []

    def visit(number: int, state: PathState, step: Step) -> None:
        own = (depth[state.lane.long()] == number).nonzero().squeeze(1)
        rays.append(rows(state.ray, own))
        lanes.append(state.lane[own].long())

    integrand = integrand._replace(max_depth=int(depth.max()) + 1).with_stages(EAGER)
    trace_attached(integrand, start, visit)
    place, found = torch.cat(lanes), joined(rays)
    return Ray(*(Vec3(*(torch.zeros_like(depth, dtype=part.dtype).index_copy(0, place, part) for part in parts))
                 for parts in found))


def _spread(hit: Hit | None, alive: Tensor, lanes: int) -> Hit | None:
    """The hits of the lanes `alive`, (M,) int32, put at these places among all N lanes; undefined elsewhere."""
    if hit is None:
        return None
    whole = Hit(*[None if part is None else part.new_empty(lanes) for part in hit])
    put_rows(whole, alive, hit)
    return whole
