"""The loop over bounces: all paths of a chunk take one step together.

    cast rays -> lanes in queues by what they meet -> `bounce` for each queue -> shadow rays -> survivors

The loop is the same forwards, where `trace.py` sums the image, and wherever a backward pass replays it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.jit.dual import dual
from torch_radbp.jit.order import nothing
from torch_radbp.path.bounce import Vertex, gathered
from torch_radbp.path.event import Ends
from torch_radbp.path.integrand import Integrand
from torch_radbp.path.lanes import put_rows
from torch_radbp.path.light_picks import picked_lights
from torch_radbp.path.sorting import first_hit, queued
from torch_radbp.path.state import Flight, PathState
from torch_radbp.path.step import Onward, Step, cut_to_count, surviving, survivors
from torch_radbp.path.through_media import free_connections, free_flights, let_through
from torch_radbp.path.vertices import bounce_queues, with_texture_values
from torch_radbp.raycast.protocol import Hit
from torch_radbp.tensors.differentiated import any_differentiated
from torch_radbp.tensors.record import rows_between
from torch_radbp.tensors.stage import stage
from torch_radbp.tensors.torch_internals import inside_dual_level
from torch_radbp.tensors.vec import Vec2, Vec3, masked, rows


def bounced(integrand: Integrand, onward: Onward, depth: int, L: Vec3 | None) -> tuple[PathState, Step, Onward]:
    """Takes one bounce of every lane, and adds to the radiance: L += beta_k E_k.

    Args:
        integrand: the scene and how to step.
        onward: the paths that take the bounce.
        depth: of the bounce.
        L: (N,) the radiance of all lanes, written into; None: it is not wanted.

    Returns:
        The paths that reached the bounce, what was decided there, and those that go on.
    """
    state = onward.packed(integrand)
    vertex, light, step = take_step(integrand, state, depth, None, onward.hit, onward.flight, with_light=L is not None)
    # L += beta_k E_k, with E_k = Le + visible Ld where paths scatter, and the light that they meet where they end.
    if L is not None:
        for order, lane, E in shown(integrand, state, vertex, light, step):
            brighten(integrand, L, state, order, lane, E)
    # L_{k+1} comes along the next ray of the paths that survive, and counts by beta_{k+1} = beta_k F_k.
    return state, step, Onward(vertex.next, surviving(step))


def take_step(integrand: Integrand, state: PathState, depth: int, step: Step | None = None,
              hit: Hit | None = None, flight: Flight | None = None,
              with_light: bool = True, factors: bool = False) -> tuple[Vertex, Vec3 | None, Step]:
    """Computes one bounce of all lanes; casts only the rays whose results `step`, `hit` and `flight` do not hold.

    Emission and next-event estimates are computed if `with_light`; `factors`: see `Settings`.

    Returns:
        The vertices of lanes that scatter, the emission seen by lanes that end (None: none do), and the decisions.
    """
    state, step = cut_to_count(state, step)
    if step is not None:
        vertex, light = bounce_queues(integrand, state, depth, step, with_light, factors)
        return with_connections(integrand, vertex, step), light, step
    # What does each ray meet, and does its flight end in a medium before? Lanes with the same event form a queue.
    hit = first_hit(integrand, state.ray, depth) if hit is None else hit
    hit, flight = free_flights(integrand, state, hit, depth) if flight is None else (hit, flight)
    queues = queued(integrand, state.ray, hit, integrand.is_last(depth), integrand.image_lanes(state), flight)
    # Which light shall each vertex connect to, where that depends on the place?
    undecided = hit.prim.new_empty(0, dtype=torch.bool)
    step = Step(hit, *queues, undecided, undecided, picked_lights(integrand, state, hit, depth, flight), flight)
    # Textures that are networks are evaluated for all queues together.
    step = with_texture_values(integrand, state, depth, step, with_light)
    # E_k, but for shadows, F_k and the next rays, queue by queue.
    vertex, light = bounce_queues(integrand, state, depth, step, with_light, factors)
    # Which connections are free?
    visible, way = nothing(vertex.survives), None
    if integrand.settings.nee and not integrand.is_last(depth):
        visible, way = free_connections(integrand, vertex, depth)
    step = step._replace(visible=visible, survives=vertex.survives, shadow_way=way)
    return with_connections(integrand, vertex, step), light, step


def with_connections(integrand: Integrand, vertex: Vertex, step: Step) -> Vertex:
    """The vertices with `Ld` attenuated by the media along their shadow rays."""
    if step.shadow_way is None or vertex.Ld is None:
        return vertex
    part = integrand.part(Ends.SURROUNDINGS)
    connection = vertex.shadow, vertex.shadow_distance, step.shadow_way._replace(crossings=None)
    return vertex._replace(Ld=integrand.stages(let_through)(part.scene, vertex.Ld, *connection))


def shown(integrand: Integrand, state: PathState, vertex: Vertex, light: Vec3 | None,
          step: Step) -> Iterator[tuple[Tensor, Tensor, LightOfBounce]]:
    """Yields a bounce's contributions to the image, of lanes that scatter and of lanes that end: the paths that contribute,
    their indices in the chunk, and what they contribute."""
    queues = [queue for queue in step.queues if queue.image and queue.event.scatters]
    if queues:
        scattered = step.order, vertex.next.lane, LightOfBounce(vertex.Le, vertex.Ld, step.visible, vertex.film)
        yield rows_between(scattered, queues[0].first, queues[-1].last)
    if light is not None:
        order = step.order[step.queues[-1].first:step.queues[-1].last]
        yield order, integrand.stages(rows)(state.lane, order), LightOfBounce(light)


class LightOfBounce(NamedTuple):
    """What a bounce contributes along M paths: E = Le + visible Ld; the image gets it times the throughput before."""

    Le: Vec3  # emission
    Ld: Vec3 | None = None  # next-event estimates without shadows; None: nothing is scattered
    visible: Tensor | None = None  # (M,) bool: their connections are free
    film: Vec2 | None = None  # of paths from lamps, their places on the film; None: these end, and are seen nowhere


def brighten(integrand: Integrand, L: Vec3 | BroughtToFilm, state: PathState, order: Tensor, lane: Tensor,
             E: LightOfBounce) -> None:
    """Adds beta E of a bounce to the radiance `L`; of paths from lamps, writes it to `L` with its place on the film.

    Args:
        integrand: the scene and how to step.
        L: of all lanes of the chunk, written into.
        state: the paths that reached the bounce.
        order: (M,) int32, the paths that contribute, in the order of `E`.
        lane: (M,) int32, their indices in the chunk.
        E: what they contribute.
    """
    Le, Ld, visible, film = E
    if isinstance(L, BroughtToFilm):
        if film is not None:
            put_rows(L, lane, BroughtToFilm(integrand.stages(shining)(state.beta, order, Le, Ld, visible), film))
    else:
        put_rows(L, lane, integrand.stages(brightened)(L, state.beta, order, lane, Le, Ld, visible))


class BroughtToFilm(NamedTuple):
    """The contributions of vertices of paths from lamps to the film, (N,)."""

    value: Vec3  # linear RGB, times the area of the image for each area there
    place: Vec2  # pixels from the upper left corner of the window


@stage("beta")
def shining(beta: Vec3, order: Tensor, Le: Vec3, Ld: Vec3 | None, visible: Tensor | None) -> Vec3:
    """What vertices of paths from lamps bring to the film: throughput beta times E. Args as for `brightened`."""
    return rows(beta, order) * (Le if Ld is None else gathered(Le, Ld, visible))


@stage("L", "beta")
def brightened(L: Vec3, beta: Vec3, order: Tensor, lane: Tensor, Le: Vec3, Ld: Vec3 | None, visible: Tensor | None) -> Vec3:
    """The radiance of some lanes with the contribution beta (Le + visible Ld) of a bounce added, (M,).

    Args:
        L: of all lanes of the chunk.
        beta: of the paths that reached the bounce.
        order: (M,) int32, the paths that contribute, in the order of the other arguments.
        lane: (M,) int32, their indices in the chunk.
        Le, Ld, visible: of the bounce; None: nothing is scattered.
    """
    return rows(L, lane) + rows(beta, order) * (Le if Ld is None else gathered(Le, Ld, visible))


class Bounce(NamedTuple):
    """One bounce of all paths, as the loop `bounces` yields it."""

    depth: int
    state: PathState  # of the paths that reach it
    vertex: Vertex  # of the lanes of `step.order` that meet an appearance
    light: Vec3 | None  # emission seen by the other lanes, which end here
    step: Step

    @property
    def ended(self) -> Tensor:
        """Indices in the chunk of the lanes that end here, int32."""
        return rows(self.state.lane, self.step.order[self.step.scattered:])

    @property
    def E(self) -> Vec3:
        """(K,) emission and next-event estimation at the vertices: E_k in L_k = E_k + F_k L_{k+1}."""
        return gathered(self.vertex.Le, self.vertex.Ld, self.step.visible)

    @property
    def F(self) -> Vec3:
        """(K,) the throughput factor F_k of the next vertex's radiance; 0 where the path ends."""
        return masked(self.step.survives, self.vertex.F)


def bounces(integrand: Integrand, state: PathState, depth: int = 0, steps: Mapping[int, Step] = {},
            hit: Hit | None = None, with_light: bool = True) -> Iterator[Bounce]:
    """Iterates over bounces until every path has ended.

    Args:
        integrand: the scene and how to step.
        state: of the paths that have reached `depth`.
        depth: of the first bounce to take.
        steps: by depth, decisions of an earlier pass; no ray is cast there.
        hit: what the first rays hit, if that is known.
        with_light: see `take_step`.
    """
    while depth < integrand.bounces and len(state.lane):
        vertex, light, step = take_step(integrand, state, depth, steps.get(depth), hit, with_light=with_light, factors=True)
        yield Bounce(depth, state, vertex, light, step)
        state, depth, hit = survivors(integrand, vertex.next, step), depth + 1, None


def film_buffer(integrand: Integrand, start: PathState) -> BroughtToFilm:
    """(N,) zeros for the contributions of a bounce to the film; dual tensors as of `radiance_buffer`."""
    place = radiance_buffer(integrand, start)
    return BroughtToFilm(radiance_buffer(integrand, start), Vec2(place.x, place.y))


def radiance_buffer(integrand: Integrand, start: PathState) -> Vec3:
    """(N,) zeros in which radiance is summed; dual tensors if the scene or the rays have tangents."""
    L = Vec3.buffer(start.pdf)
    moves = inside_dual_level() and (integrand.attached or any_differentiated(start))
    return dual(L, Vec3.buffer(start.pdf)) if moves else L
