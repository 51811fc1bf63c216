"""The loop over bounces with all derivatives, as torch records them or carries tangents along."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_radbp.adjoint.local_map import Verdict
from torch_radbp.path.bounce import places_of
from torch_radbp.path.integrand import Integrand
from torch_radbp.path.state import PathState
from torch_radbp.path.texture_networks import texture_values_at
from torch_radbp.path.trace import trace
from torch_radbp.path.wavefront import Step, add_at, first_hit, surviving, take_step
from torch_radbp.raycast.protocol import Hit
from torch_radbp.tensors.differentiated import detached
from torch_radbp.tensors.record import joined, rows_between
from torch_radbp.tensors.vec import Ray, Vec3, rows


def trace_attached(integrand: Integrand, state: PathState, visit=None) -> Vec3:
    """`trace` with all derivatives, in reverse mode (recorded) or in forward mode (of dual tensors).

    Where rays carry derivatives, each bounce is taken twice: once detached, to find out what the next ray meets, and then
    attached to that.
    """
    if not integrand.settings.moving:
        return trace(integrand, state, visit)
    fixed = integrand._replace(scene=integrand.proposal, parts={})
    L, depth = Vec3.buffer(state.beta.x.detach()), 0
    hit = first_hit(fixed, detached(state).ray, depth)
    while depth < integrand.max_depth and len(state.lane):
        vertex, _, step = take_step(fixed, detached(state), depth, hit=hit, with_light=False)
        alive, last = surviving(step), integrand.is_last(depth)
        hit = None if last else fixed.caster.intersect(rows(vertex.next.ray, alive))
        following = spread(hit, alive, vertex.shadow_distance)
        if visit is not None:
            visit(depth, state, step)
        arrival, verdict = rows(step.arrival(state), step.order), Verdict(step.visible, step.survives)
        ahead = []
        for queue in step.queues:
            here = rows_between(arrival, queue.first, queue.last)
            decided, there = (None if not queue.event.scatters else rows_between(record, queue.first, queue.last)
                              for record in (verdict, following))
            then = here.state
            part = integrand.part(queue.event)
            settings = integrand.settings_at(depth)
            at = integrand.at(depth)
            texture_values = texture_values_at(integrand.scene, integrand.scatterer(queue.event),
                                               places_of(part.scene, part.proposal, here, at, settings))
            local = integrand.stages.local_map(part.scene, part.proposal, here, decided, there, at, settings, texture_values,
                                               None, None)
            add_at(L, then.lane, then.beta * local.E)
            ahead.append(then if local.ray is None else
                         PathState(local.ray, then.beta * local.F, local.pdf, then.key, then.lane,
                                   rows_between(vertex.next.vantage, queue.first, queue.last), local.followed, local.cone))
        state, depth = rows(joined(ahead), alive), depth + 1
    return L


def rays_reaching(integrand: Integrand, start: PathState, depth: Tensor) -> Ray:
    """The rays that reach the vertices of paths at these depths, with all derivatives.

    Args:
        integrand: attached.
        start: (N,) of the paths, attached.
        depth: (N,) int64, less than the vertices of each.
    """
    rays, lanes = [], []

    def visit(number: int, state: PathState, step: Step) -> None:
        own = (depth[state.lane.long()] == number).nonzero().squeeze(1)
        rays.append(rows(state.ray, own))
        lanes.append(state.lane[own].long())

    integrand = integrand._replace(max_depth=int(depth.max()) + 1).with_stages(integrand.stages.eager())
    trace_attached(integrand, start, visit)
    place, found = torch.cat(lanes), joined(rays)
    return Ray(*(Vec3(*(torch.zeros_like(depth, dtype=part.dtype).index_copy(0, place, part) for part in parts))
                 for parts in found))


def spread(hit: Hit | None, alive: Tensor, like: Tensor) -> Hit | None:
    """The hits of the lanes `alive`, among misses of all others.

    Args:
        like: (M,) of all lanes, floating point.
    """
    if hit is None:
        return None
    zero = torch.zeros_like(like)
    nothing = torch.zeros_like(like, dtype=hit.prim.dtype)
    miss = Hit(nothing - 1, zero, zero, zero, None if hit.instance is None else nothing)
    return Hit(*(None if new is None else old.index_copy(0, alive.long(), new) for old, new in zip(miss, hit)))
