"""The rays that leave chains of vertices, with their derivatives."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.adjoint.function import asks_for_gradient, first_derivatives_only
from torch_radbp.adjoint.scatter import Gradients, gradients_of
from torch_radbp.adjoint.sweep import PathRecord, numbered_leaves
from torch_radbp.adjoint.taped_sweep import sweep_of
from torch_radbp.boundary.eye.deposit import MotionFunction
from torch_radbp.boundary.eye.ideal_paths import NO_ROULETTE, only_ideal
from torch_radbp.path.integrand import Integrand
from torch_radbp.path.lanes import put_rows
from torch_radbp.path.state import PathState
from torch_radbp.path.step import Step, survivors
from torch_radbp.path.wavefront import take_step
from torch_radbp.public_call import public_call
from torch_radbp.raycast.protocol import Hit
from torch_radbp.scene.tables.scene_tensors import SceneTensors
from torch_radbp.tensors.differentiated import detached, differentiable
from torch_radbp.tensors.record import leaves_of
from torch_radbp.tensors.vec import Ray, Vec3, rows
from torch_radbp.tensors.vector_jacobian import zeros_unless


class Chains(NamedTuple):
    """K chains of ideal vertices, from the camera on; detached."""

    states: dict[int, PathState]  # by index of the vertex, of paths that go on there
    steps: dict[int, Step]
    depth: Tensor  # (K,) int64, number of vertices
    ray: Ray  # leaves the last vertex


def follows_chains(integrand: Integrand) -> Integrand:
    """The integrand by which chains of ideal vertices are traced and differentiated."""
    integrand = only_ideal(integrand)
    # Whether all directions are followed or not.
    return integrand._replace(settings=integrand.settings._replace(moving=True, sampling="hybrid"))


def chains_of(integrand: Integrand, start: PathState, depth: Tensor) -> Chains:
    """Traces chains of ideal vertices of given lengths.

    Args:
        integrand: from `follows_chains`, with a detached scene.
        start: (K,) the initial path states.
        depth: (K,) int64, the number of vertices of each chain, less than that of the path.
    """
    state, states, steps, ends = start, {}, {}, []
    while len(state.lane):
        left = depth[state.lane.long()] - len(steps)
        ends.append((state.lane[left == 0], rows(state.ray, (left == 0).nonzero().squeeze(1))))
        state = rows(state, (left > 0).nonzero().squeeze(1))
        if len(state.lane):
            states[len(steps)] = state
            vertex, _, step = take_step(integrand, state, len(steps), with_light=False)
            steps[len(steps)] = step
            state = survivors(integrand, vertex.next, step)
    ray = Ray(Vec3.buffer(start.pdf), Vec3.buffer(start.pdf))
    for lane, found in ends:
        put_rows(ray, lane, found)
    return Chains(states, steps, depth, ray)


def adjoint_of_start(integrand: Integrand, chains: Chains, adj_ray: Ray, wanted: tuple[bool, ...],
                     gradients: Gradients, met: Hit | None = None) -> Ray:
    """The adjoints of the first rays of chains, from those of the rays that leave them; adds to the scene's gradients.

    Args:
        integrand: by which the chains were traced.
        chains: (K,) the chains.
        adj_ray: the adjoints of the rays that leave them.
        wanted: for each leaf of the scene, in the order of `leaves_of`, whether `gradients` have it.
        gradients: added to.
        met: what the rays that leave the chains hit, to which directions may be fixed; None: their directions are ideal.
    """
    record = PathRecord(lambda: chains.states[0], None, chains.states, chains.steps, len(chains.steps))
    numbered = numbered_leaves(integrand.scene, wanted)
    with sweep_of(integrand, record, Vec3.buffer(adj_ray.d.x), numbered, gradients) as sweep:
        for number in reversed(range(len(chains.steps))):
            own = (chains.depth == number + 1).nonzero().squeeze(1).int()
            put_rows(sweep.memo.adj_ray, own, rows(adj_ray, own))
            if met is not None:
                put_rows(sweep.memo.hit, own, rows(met, own))
            sweep.adjoint(chains.states[number], number)
    return sweep.memo.adj_ray


class Follows(NamedTuple):
    """The derivatives of K numbers by the rays that leave and that begin chains of ideal vertices."""

    integrand: Integrand
    chains: Chains
    adj_ray: Ray  # by the rays that leave the chains
    adj_start: Ray  # by the first rays of the chains


def following(follows: Follows, start: Ray, scene: SceneTensors) -> Tensor:
    """(K,) float64 zeros that carry derivatives through chains of mirrors and glass to camera rays and the scene.

    Args:
        follows: the derivatives by the rays of the chains.
        start: the first rays of the chains, attached.
        scene: attached.
    """
    integrand, chains, adj_ray, adj_start = follows._replace(integrand=follows.integrand._replace(caster=None))
    wanted, leaves = tuple(asks_for_gradient(scene)), differentiable(scene)
    shapes = [leaf.detach() for leaf in leaves]

    def adjoint(asked: Tensor) -> list[Tensor | None]:
        asked = asked.to(adj_start.d.x.dtype)
        of_start = [part * asked for part in leaves_of(adj_start)]
        if not shapes:
            return of_start
        gradients = Gradients(shapes)
        adjoint_of_start(integrand, chains, Ray(*(part * asked for part in adj_ray)), wanted, gradients)
        return of_start + gradients_of([gradients])[0]

    return MotionFunction.apply(len(chains.depth), adjoint, *leaves_of(start), *leaves)


class RayFunction(torch.autograd.Function):
    """The rays that leave K chains as an `autograd.Function` of their first rays and the scene's tensors."""

    @staticmethod
    def forward(ctx, ray: Ray, adjoint: Callable[[Ray], Sequence[Tensor | None]], *leaves: Tensor) -> tuple[Tensor, ...]:
        ctx.adjoint, ctx.like = adjoint, ray.d.x
        return tuple([part.clone() for part in leaves_of(ray)])

    @staticmethod
    @first_derivatives_only
    @torch.autograd.function.once_differentiable
    @public_call
    def backward(ctx, *adj_ray: Tensor | None):
        adj_ray = [zeros_unless(part, ctx.like).contiguous() for part in adj_ray]
        return None, None, *ctx.adjoint(Ray(Vec3(*adj_ray[:3]), Vec3(*adj_ray[3:])))


def rays_along(integrand: Integrand, start: PathState, depth: Tensor, met: Hit, scene: SceneTensors) -> Ray:
    """The rays that reach the vertices of paths at given depths, with all derivatives, for the backward pass alone.

    Autograd records one operation, which traces the vertices again, instead of each of them as
    `adjoint.attached.rays_reaching` does.

    Args:
        integrand: with a detached scene.
        start: (K,) the states at the start of the paths, attached.
        depth: (K,) int64, at least 1, and less than the number of vertices of each path.
        met: (K,) the hits of these rays.
        scene: attached.
    """
    settings = integrand.settings._replace(nee=False)
    integrand = integrand._replace(settings=settings, rr_depth=NO_ROULETTE, max_depth=int(depth.max()) + 1, parts={})
    with torch.no_grad():
        chains = chains_of(integrand, detached(start), depth)
    integrand, wanted, leaves = integrand._replace(caster=None), tuple(asks_for_gradient(scene)), differentiable(scene)
    shapes = [leaf.detach() for leaf in leaves]

    def adjoint(adj_ray: Ray) -> list[Tensor | None]:
        gradients = Gradients(shapes)
        adj_start = adjoint_of_start(integrand, chains, adj_ray, wanted, gradients, met)
        return leaves_of(adj_start) + (gradients_of([gradients])[0] if shapes else [])

    found = RayFunction.apply(chains.ray, adjoint, *leaves_of(start.ray), *leaves)
    return Ray(Vec3(*found[:3]), Vec3(*found[3:]))
