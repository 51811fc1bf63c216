"""Plain autograd."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.utils._pytree import tree_map

from torch_radbp.adjoint.local_map import local_map
from torch_radbp.path import Integrand, PathState, add_at, first_hit, surviving, take_step, trace
from torch_radbp.raycast.protocol import Hit
from torch_radbp.vec import Vec3, rows


@dataclass(frozen=True)
class TapeAdjoint:
    """Lets autograd record every operation of the forward pass: the oracle of the tests.

    Memory grows with everything that is computed. Takes no part in the one `autograd.Function`; the loop over bounces is
    recorded as it runs.
    """


def trace_attached(integrand: Integrand, state: PathState, visit=None) -> Vec3:
    """`trace` with all derivatives, in reverse mode (recorded) or in forward mode (of dual tensors).

    Where rays carry derivatives, each bounce is taken twice: once detached, to find out what the next ray meets, and then
    attached to that.
    """
    if not integrand.settings.moving:
        return trace(integrand, state, visit)
    fixed = integrand._replace(scene=integrand.proposal)
    L, depth = Vec3.buffer(state.beta.x.detach()), 0
    hit = first_hit(fixed, detached(state).ray, depth)
    while depth < integrand.max_depth and len(state.lane):
        vertex, step = take_step(fixed, detached(state), depth, hit=hit)
        alive = surviving(step)
        last = depth + 1 >= integrand.max_depth
        hit = None if last else fixed.caster.intersect(rows(vertex.next.ray, alive))
        local = local_map(integrand.scene, integrand.proposal, state, step, spread(hit, alive, step.hit),
                          integrand.at(depth), integrand.settings_at(depth))
        add_at(L, state.lane, state.beta * local.E)
        if last:
            break
        state = rows(PathState(local.ray, state.beta * local.F, local.pdf, state.key, state.lane), alive)
        depth += 1
    return L


def detached(state: PathState) -> PathState:
    """The state without derivatives."""
    return tree_map(Tensor.detach, state)


def spread(hit: Hit | None, alive: Tensor, like: Hit) -> Hit | None:
    """The hits of the lanes `alive`, among misses of all others."""
    if hit is None:
        return None
    miss = Hit(torch.full_like(like.prim, -1), *(torch.zeros_like(part) for part in like[1:]))
    return Hit(*(old.index_copy(0, alive, new) for old, new in zip(miss, hit)))
