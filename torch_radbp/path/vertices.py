"""The vertices of a bounce, queue by queue: each event's lanes go through the functions of that."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from torch_radbp.interface.texture import TextureValue
from torch_radbp.jit.dual import dual
from torch_radbp.path.bounce import Vertex
from torch_radbp.path.integrand import Integrand
from torch_radbp.path.queues import Queue
from torch_radbp.path.state import Arrival, PathState
from torch_radbp.path.step import Step
from torch_radbp.path.texture_networks import values_of_queues
from torch_radbp.tensors.record import joined
from torch_radbp.tensors.torch_internals import inside_dual_level
from torch_radbp.tensors.vec import Vec2, Vec3
from torch_radbp.threads.team import loops_together

# Appearances of a scene up to which the lanes of the derivative alone have functions of their own, without light: steps are
# quicker by up to a tenth, but each is compiled twice, which a scene of many would wait for.
FEW = 4


def bounce_queues(integrand: Integrand, state: PathState, depth: int, step: Step,
                  with_light: bool, factors: bool = False) -> tuple[Vertex, Vec3 | None]:
    """Evaluates the vertices of lanes that scatter, queue by queue, and the emission seen by lanes that end. Args as for
    `wavefront.take_step`."""
    settings, from_lamps = integrand.settings_at(depth), integrand.proposal.layout.from_lamps
    settings = settings._replace(moving=False, sampling="detached", factors=factors)
    arrival, at, known = step.arrival(state), integrand.at(depth), dict(zip(step.queues, step.texture_values))

    def arguments(queue: Queue, reached, at, settings) -> tuple:
        part, texture_values = integrand.part(queue.event), known[queue]
        if texture_values is None:
            texture_values, = texture_values_of(integrand, arrival, depth, [queue], step.order)
        return part.scene, part.proposal, reached, step.order[queue.first:queue.last], at, settings, texture_values

    *_, last = step.queues
    ends = with_light and last.image and not last.event.scatters
    light = integrand.part(last.event).evaluate(*arguments(last, arrival, at, settings)) if ends else None
    queues = [queue for queue in step.queues if queue.event.scatters]
    bounces = [integrand.part(queue.event).evaluate for queue in queues]
    if not bounces:
        return room_for_vertices(state, 0, with_light, factors, from_lamps), light
    reached, at = bounces[0].taken(arrival=arrival, at=at)
    apart = len(integrand.proposal.layout.appearances) <= FEW
    shows = [(with_light and queue.image) or not apart for queue in queues]
    kinds = {shown: bounces[0].taken(settings=settings._replace(shown=shown))[0] for shown in set(shows)}
    prepared = [arguments(queue, reached, at, kinds[shown]) for queue, shown in zip(queues, shows)]
    if len(bounces) == 1 or not bounces[0].is_compiled:
        return joined([bounce(*of_queue) for bounce, of_queue in zip(bounces, prepared)]), light
    vertices = room_for_vertices(state, step.scattered, any(shows), factors, from_lamps)
    if integrand.attached and inside_dual_level():
        tangents = room_for_vertices(state, step.scattered, any(shows), factors, from_lamps)
        ahead = vertices.next._replace(beta=dual(vertices.next.beta, tangents.next.beta))
        vertices = vertices._replace(**{part: dual(getattr(vertices, part), getattr(tangents, part)) for part in (
            "Le", "Ld", "F", "film") if getattr(vertices, part) is not None}, next=ahead)
    rooms = {True: vertices, False: vertices._replace(Le=None, Ld=None, film=None)}
    rooms = {shown: bounces[0].room(rooms[shown]) for shown in kinds}
    with loops_together():
        for bounce, queue, of_queue, shown in zip(bounces, queues, prepared, shows):
            bounce.into(rooms[shown], queue.first, *of_queue)
    return vertices, light


def with_texture_values(integrand: Integrand, state: PathState, depth: int, step: Step, with_light: bool) -> Step:
    """The step with the values of network textures at the vertices of a bounce."""
    asking = [queue for queue in step.queues if queue.event.scatters or (with_light and queue.image)]
    values = dict(zip(asking, texture_values_of(integrand, step.arrival(state), depth, asking, step.order)))
    return step._replace(texture_values=tuple(map(values.get, step.queues)))


def texture_values_of(integrand: Integrand, arrival: Arrival, depth: int, queues: Sequence[Queue],
                      order: Tensor) -> list[tuple[TextureValue, ...]]:
    """The values of network textures at the vertices of some queues; `order`: see `Step`."""
    return values_of_queues(integrand.scene, [
        (integrand.scatterer(queue.event), integrand.places(queue.event, arrival, order[queue.first:queue.last], depth))
        for queue in queues])


def room_for_vertices(state: PathState, lanes: int, with_light: bool, factors: bool, from_lamps: bool) -> Vertex:
    """The uninitialised terms, shadow rays and next states of `lanes` vertices, to write results into.

    Args:
        state: of the paths, gives dtypes.
        lanes: how many.
        with_light: with emission and next-event estimates; `factors`: with F; `from_lamps`: with film positions.
    """
    def room(part):
        if part is None or isinstance(part, Tensor):
            return None if part is None else part.new_empty(lanes)
        return type(part)(*map(room, part))

    def number() -> Tensor:
        return state.pdf.new_empty(lanes)

    Le, Ld, F = (Vec3(number(), number(), number()) if there else None for there in (with_light, with_light, factors))
    survives = number().new_empty(lanes, dtype=torch.bool)
    film = Vec2(number(), number()) if with_light and from_lamps else None
    return Vertex(Le, Ld, F, room(state.ray), number(), room(state.medium), room(state), survives, film)
