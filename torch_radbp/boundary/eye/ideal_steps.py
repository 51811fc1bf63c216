"""The loop over ideal vertices: all paths take one step together; those go on that scatter into one direction.

What is done with lanes on a step is recorded once for scenes of one kind, and then done again, as bounces are; see
`path/taped_bounces.py`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.eye.surfaces import Surfaces, cells_met
from torch_radbp.jit.arguments import PreparedArgument
from torch_radbp.jit.cpu.board import board
from torch_radbp.jit.dual import tangents_and_tensors
from torch_radbp.jit.order import chosen, partition
from torch_radbp.jit.recording.recording import Reserve
from torch_radbp.jit.tape import Played, Tape
from torch_radbp.path.bounce import Vertex
from torch_radbp.path.event import SurfaceMet
from torch_radbp.path.integrand import Integrand
from torch_radbp.path.lanes import put_rows
from torch_radbp.path.queues import Queue
from torch_radbp.path.sorting import appearances_met, first_hit
from torch_radbp.path.state import PathState, Position
from torch_radbp.path.step import Onward, Step
from torch_radbp.path.taped_bounces import blank_lanes, recordable, tape_of
from torch_radbp.path.vertices import bounce_queues
from torch_radbp.raycast.protocol import Hit
from torch_radbp.tensors.stage import stage
from torch_radbp.tensors.vec import Ray, Vec3, dot, max_component, rows
from torch_radbp.vertex.cone import Cone
from torch_radbp.vertex.interaction import shading_normal, triangle_normal

# What is known of a vertex, bits of a number: the path meets the side of the shading normal; it is scattered ideally, and
# goes on; to the other side of the shading normal; on the side of the triangle's own normal; the light of a sample reaches
# it, and is scattered there.
FRONT, ONWARDS, THROUGH, OUTSIDE, LIT = (1 << bit for bit in range(5))


class Reached(NamedTuple):
    """The hits of paths after the same number of ideal vertices, (M,); detached."""

    ray: Ray
    beta: Vec3  # throughput of the ideal vertices before
    cone: Cone | None  # around the ray; None: no texture asks
    hit: Hit
    what: Tensor  # (M,) int32, FRONT + ...: kind of surface and side
    cells: tuple[Tensor, ...]  # (M,) each, from `cells_met`


class Ideal(NamedTuple):
    """The appearances of a scene with an ideal lobe (mirrors, glass)."""

    numbers: tuple[int, ...]
    queue_of: Tensor  # (A + M + 1,) int32: for each event its index among these; others have their number


def ideal_of(integrand: Integrand) -> Ideal:
    """Finds the appearances of a scene with an ideal lobe."""
    layout = integrand.proposal.layout
    numbers = tuple(number for number, appearance in enumerate(layout.appearances) if appearance.kind.delta)
    events = len(layout.appearances) + len(layout.scattering_media) + 1
    places = [numbers.index(number) if number in numbers else len(numbers) for number in range(events)]
    return Ideal(numbers, torch.tensor(places, dtype=torch.int32, device=integrand.proposal.device))


IdealStep = Callable[[Onward, int], tuple[Tensor, Reached, Onward | None]]


def ideal_step(integrand: Integrand, surfaces: Surfaces, ideal: Ideal, onward: Onward,
               depth: int) -> tuple[Tensor, Reached, Onward | None]:
    """Traces one vertex of every path: the hits, and the paths that ideal mirrors or glass scatter on.

    Args:
        integrand: from `only_ideal`, of a detached scene.
        surfaces: of the scene, prepared for the stages.
        ideal: the ideal appearances of the scene.
        onward: the paths.
        depth: of the vertex.

    Returns:
        The lanes of the paths, their hits, and the paths that go on; None: none does.
    """
    state, stages = onward.packed(integrand), integrand.stages
    hit = first_hit(integrand, state.ray, depth)
    onwards, ahead = stages(no_direction)(state.ray.d), None
    order, vertex = (state.lane[:0], None) if integrand.is_last(depth) else (
        ideally_scattered(integrand, ideal, state, hit, depth))
    if vertex is not None:
        goes_on = chosen(stages(scattered_ideally)(vertex.next.pdf, vertex.survives, vertex.next.beta))
        put_rows(onwards, *stages(rows)((order, vertex.next.ray.d), goes_on))
        ahead = Onward(vertex.next, goes_on)
    return state.lane, stages(ideal_vertex)(surfaces, state.ray, state.beta, state.cone, hit, onwards), ahead


def ideally_scattered(integrand: Integrand, ideal: Ideal, state: PathState, hit: Hit,
                      depth: int) -> tuple[Tensor, Vertex | None]:
    """The lanes that hit surfaces with an ideal lobe, (M,) int32, and their vertices; None if there are none."""
    number, front = appearances_met(integrand, state.ray, hit)
    order, counts = partition(integrand.stages(rows)(ideal.queue_of, number), len(ideal.numbers) + 1)
    queues, first = [], 0
    for appearance, count in zip(ideal.numbers, counts):
        if count:
            queues.append(Queue(SurfaceMet(appearance), first, first + count))
        first += count
    if not queues:
        return order[:0], None
    undecided = hit.prim.new_empty(0, dtype=torch.bool)
    step = Step(hit, front, order[:first], tuple(queues), undecided, undecided, texture_values=(None,) * len(queues))
    vertex, _ = bounce_queues(integrand, state, depth, step, with_light=False)
    return step.order, vertex


@stage()
def no_direction(d: Vec3) -> Vec3:
    """(N,) zero vectors, into which directions are written."""
    return d * 0.0


@stage()
def scattered_ideally(pdf: Tensor, survives: Tensor, beta: Vec3) -> Tensor:
    """(N,) bool: paths that go on in a direction that is not random."""
    return torch.isinf(pdf) & survives & (max_component(beta) > 0)


@stage("surfaces")
def ideal_vertex(surfaces: Surfaces, ray: Ray, beta: Vec3, cone: Cone | None, hit: Hit, onwards: Vec3) -> Reached:
    """The hits of rays, (N,), with flags of side and ideal scattering, and the cells between texture lines that are hit.

    Args:
        surfaces: of the scene.
        ray, beta, cone: of the paths, as of `Reached`.
        hit: what the rays hit.
        onwards: directions into which they are ideally scattered; 0: none.
    """
    n = triangle_normal(surfaces, hit)
    shading = shading_normal(surfaces, hit, n)
    cosine, met = dot(shading, ray.d), hit.prim >= 0
    goes_on = dot(onwards, onwards) > 0.0
    what = torch.zeros_like(hit.prim)
    for bit, holds in ((FRONT, (cosine < 0.0) | ~met), (ONWARDS, goes_on), (THROUGH, dot(shading, onwards) * cosine > 0.0),
                       (OUTSIDE, dot(n, onwards) > 0.0)):
        what = what + torch.where(holds, bit, 0).to(what.dtype)
    return Reached(ray, beta, cone, hit, what, cells_met(surfaces, hit))


def steps_played(integrand: Integrand, surfaces: PreparedArgument, ideal: Ideal, tape: Tape, onward: Onward,
                 depth: int) -> tuple[Tensor, Reached, Onward | None]:
    """Takes one step of ideal paths by recorded machine code, or by `ideal_step` where that is not possible."""
    def step(onward: Onward, at: Position) -> Played:
        return Played(ideal_step(integrand, surfaces, ideal, onward, depth))

    def blank(arguments: tuple, reserve: Reserve) -> tuple:
        (onward, _, at) = blank_lanes((arguments[0], None, arguments[1]), reserve)
        return onward, at

    played = tape.play(integrand.kind_at(depth), step, (onward, integrand.at(depth)), onward.count, blank)
    return ideal_step(integrand, surfaces, ideal, onward, depth) if played is None else played.results


@contextmanager
def steps_taken(integrand: Integrand, surfaces: Surfaces | PreparedArgument, start: PathState) -> Iterator[IdealStep]:
    """Yields a function that takes one step of ideal paths, by machine code if possible. Args as for `ideal_path`."""
    ideal = ideal_of(integrand)
    if not recordable(integrand):
        yield partial(ideal_step, integrand, surfaces, ideal)
        return
    with board() as helpers:
        tables = ideal.queue_of, *tangents_and_tensors(surfaces.argument)
        tape = tape_of(integrand, start.pdf.dtype, helpers, tables, ("ideal", ideal.numbers, surfaces.form.structure))
        yield partial(steps_played, integrand, surfaces, ideal, tape)
