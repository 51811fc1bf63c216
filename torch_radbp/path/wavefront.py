"""The loop over bounces: all paths of a chunk take one step together.

    cast rays -> lanes in queues by the appearance of what they meet -> `bounce` for each queue -> shadow rays -> survivors

The loop is the same forwards, where `trace.py` sums the image, and wherever a backward pass replays it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.jit.dual import dual, tangents_and_tensors
from torch_radbp.jit.lane_count import LaneCount, waited_for
from torch_radbp.jit.order import chosen, inverted, nothing, put
from torch_radbp.jit.team import loops_together
from torch_radbp.path.bounce import Vertex, chance_of_light, emitter_met, gathered, pick_light
from torch_radbp.path.event import Ends
from torch_radbp.path.integrand import Integrand
from torch_radbp.path.lane_room import ASKED, power_of_2
from torch_radbp.path.queues import EMPTY, ImageLanes, Queue, appearance_met, one_queue, queues_by, shines, side_met
from torch_radbp.path.state import Arrival, PathState
from torch_radbp.path.texture_networks import values_of_queues
from torch_radbp.raycast.protocol import Hit
from torch_radbp.scene.camera_hit import camera_hit
from torch_radbp.scene.light_choice import LightPick
from torch_radbp.tensors.differentiated import any_differentiated
from torch_radbp.tensors.record import joined, leaves_of, rows_between
from torch_radbp.tensors.stage import stage
from torch_radbp.tensors.torch_internals import inside_dual_level
from torch_radbp.tensors.vec import Ray, Vec3, masked, rows
from torch_radbp.texture.reader import TextureValue

# Appearances of a scene up to which the lanes of the derivative alone have functions of their own, without light: steps are
# quicker by up to a tenth, but each is compiled twice, which a scene of many would wait for.
FEW = 4


class Step(NamedTuple):
    """The decisions of a bounce: hits, queues, visibility and survival, to be repeated without casting rays.

    Whoever takes the bounce again goes by this record, so that all agree even where rounding would decide otherwise (of
    another device, another number of threads, a compiled function and an eager one).
    """

    hit: Hit  # (N,) of the paths that reach the bounce
    front: Tensor | None  # (N,) bool, see `Arrival`
    order: Tensor  # (M,) int32, these paths sorted by queue; those without surface or light are left out
    queues: tuple[Queue, ...]
    visible: Tensor  # (K,) bool: the shadow ray was free; of the first K of `order`, which hit a surface
    survives: Tensor  # (K,) bool: the path goes on
    picked: LightPick | None = None  # (N,) None: lights are selected by constant probabilities
    # Of each queue those of textures that are read outside; None: not computed. In a forward pass attached to the scene.
    texture_values: tuple[tuple[TextureValue, ...] | None, ...] = ()

    @property
    def scattered(self) -> int:
        """K, the number of lanes that hit a surface."""
        return next((queue.first for queue in self.queues if not queue.event.scatters), self.queues[-1].last)

    def arrival(self, state: PathState) -> Arrival:
        """The paths that reach the bounce, with their hits."""
        return Arrival(state, self.hit, self.front, self.picked)


def take_step(integrand: Integrand, state: PathState, depth: int, step: Step | None = None,
              hit: Hit | None = None, with_light: bool = True) -> tuple[Vertex, Vec3 | None, Step]:
    """Takes one bounce of every lane; casts rays only where `step` and `hit` do not hold their answers.

    What lanes bring to the image is found where it counts there and `with_light` asks for it.

    Returns:
        The vertices of the lanes that meet an appearance, the light that those meet that end (None: none do), and the
        decisions.
    """
    state, step = cut_to_count(state, step)
    if step is None:
        hit = first_hit(integrand, state.ray, depth) if hit is None else hit
        undecided = hit.prim.new_empty(0, dtype=torch.bool)
        queues = queued(integrand, state.ray, hit, integrand.is_last(depth), integrand.image_lanes(state))
        step = Step(hit, *queues, undecided, undecided, picked_lights(integrand, state, hit, depth))
        asking = [queue for queue in step.queues if queue.event.scatters or (with_light and queue.image)]
        known = dict(zip(asking, texture_values_of(integrand, step.arrival(state), depth, asking, step.order)))
        step = step._replace(texture_values=tuple(map(known.get, step.queues)))
        vertex, light = bounce_queues(integrand, state, depth, step, with_light)
        connects = integrand.settings.nee and not integrand.is_last(depth)
        visible = inverted(integrand.caster.occluded(vertex.shadow, vertex.shadow_distance)) if connects else (
            nothing(vertex.survives))
        return vertex, light, step._replace(visible=visible, survives=vertex.survives)
    return *bounce_queues(integrand, state, depth, step, with_light), step


def cut_to_count(state: PathState, step: Step | None) -> tuple[PathState, Step | None]:
    """A state and what was decided there, of as many lanes as there are; waits for the device if it alone knows."""
    state = state.cut_to_count()
    if step is None or not isinstance(step.queues[-1].last, LaneCount):
        return state, step
    counts = step.queues[-1].last.counts.tolist()
    found = [(queue._replace(first=counts[queue.first.number], last=counts[queue.last.number]), values)
             for queue, values in zip(step.queues, step.texture_values)]
    queues, values = zip(*([each for each in found if each[0].first < each[0].last] or [(EMPTY, ())]))
    hit, front, picked = rows_between((step.hit, step.front, step.picked), 0, len(state.lane))
    step = Step(hit, front, step.order[:queues[-1].last], queues, step.visible, step.survives, picked, values)
    return state, step._replace(visible=step.visible[:step.scattered], survives=step.survives[:step.scattered])


def bounce_queues(integrand: Integrand, state: PathState, depth: int, step: Step,
                  with_light: bool) -> tuple[Vertex, Vec3 | None]:
    """Computes the vertices of lanes that hit a surface, queue by queue, and the emission seen by the others."""
    settings = integrand.settings_at(depth)._replace(moving=False, sampling="detached")
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
        return room_for_vertices(state, 0, with_light), light
    reached, at = bounces[0].taken(arrival=arrival, at=at)
    apart = len(integrand.proposal.layout.appearances) <= FEW
    shows = [(with_light and queue.image) or not apart for queue in queues]
    kinds = {shown: bounces[0].taken(settings=settings._replace(shown=shown))[0] for shown in set(shows)}
    prepared = [arguments(queue, reached, at, kinds[shown]) for queue, shown in zip(queues, shows)]
    if len(bounces) == 1 or not bounces[0].is_compiled:
        return joined([bounce(*of_queue) for bounce, of_queue in zip(bounces, prepared)]), light
    vertices = room_for_vertices(state, step.scattered, any(shows))
    if integrand.attached and inside_dual_level():
        tangents = room_for_vertices(state, step.scattered, any(shows))
        vertices = vertices._replace(Le=dual(vertices.Le, tangents.Le), Ld=dual(vertices.Ld, tangents.Ld),
                                     F=dual(vertices.F, tangents.F), next=vertices.next._replace(
                                         beta=dual(vertices.next.beta, tangents.next.beta)))
    rooms = {True: vertices, False: vertices._replace(Le=None, Ld=None, F=None)}
    rooms = {shown: bounces[0].room(rooms[shown]) for shown in kinds}
    with loops_together():
        for bounce, queue, of_queue, shown in zip(bounces, queues, prepared, shows):
            bounce.into(rooms[shown], queue.first, *of_queue)
    return vertices, light


def texture_values_of(integrand: Integrand, arrival: Arrival, depth: int, queues: Sequence[Queue],
                      order: Tensor) -> list[tuple[TextureValue, ...]]:
    """Evaluates the network textures of some queues' lanes; `order`: see `Step`."""
    return values_of_queues(integrand.scene, [
        (integrand.scatterer(queue.event), integrand.places(queue.event, arrival, order[queue.first:queue.last], depth))
        for queue in queues])


def room_for_vertices(state: PathState, lanes: int, with_light: bool) -> Vertex:
    """Empty vertices to write results into."""
    def room(part):
        if part is None or isinstance(part, Tensor):
            return None if part is None else part.new_empty(lanes)
        return type(part)(*map(room, part))

    def number() -> Tensor:
        return state.pdf.new_empty(lanes)

    Le, Ld, F = (Vec3(number(), number(), number()) if with_light else None for _ in range(3))
    return Vertex(Le, Ld, F, room(state.ray), number(), room(state), number().new_empty(lanes, dtype=torch.bool))


def picked_lights(integrand: Integrand, state: PathState, hit: Hit, depth: int) -> LightPick | None:
    """Selects lights for paths with hits; None if selection does not depend on the point."""
    choice = integrand.proposal.lights.choice
    if not integrand.settings.nee or not integrand.proposal.lights.by_place:
        return None
    part, arrival = integrand.part(Ends.SURROUNDINGS), Arrival(state, hit, None)
    lit, none = part.call(emitter_met, hit)
    if depth > 0 and len(lanes := chosen(lit)):
        put_rows((none.chance,), lanes, (part.call(chance_of_light, choice, arrival, lanes),))
    if integrand.is_last(depth):
        return none
    return LightPick(*part.call(pick_light, choice, arrival, integrand.at(depth)), none.chance)


def queued(integrand: Integrand, ray: Ray, hit: Hit, last: bool,
           image_lanes: ImageLanes | None = None) -> tuple[Tensor | None, Tensor, tuple[Queue, ...]]:
    """Sorts rays with hits into queues: `Step.front`, `Step.order` and `Step.queues`.

    Args:
        ray, hit: (N,).
        last: whether only what is emitted counts.
        image_lanes: those of the image alone; None: there are none.
    """
    layout, part = integrand.proposal.layout, integrand.part(Ends.SURROUNDINGS)
    if last:
        return None, *one_queue(Ends.LAST_BOUNCE, part.call(shines, hit, image_lanes))
    number, front = appearances_met(integrand, ray, hit, image_lanes)
    return front, *queues_by(number, len(layout.appearances), layout.surround is not None, image_lanes is not None)


def appearances_met(integrand: Integrand, ray: Ray, hit: Hit,
                    image_lanes: ImageLanes | None = None) -> tuple[Tensor, Tensor | None]:
    """The appearance numbers of rays with hits, (N,) int32, for `queues_by`, and `Step.front`; args as for `queued`."""
    part = integrand.part(Ends.SURROUNDINGS)
    number, differs = part.call(appearance_met, hit, integrand.no_appearance, image_lanes)
    front = None if differs is None else nothing(differs)
    if differs is not None and len(lanes := chosen(differs)):
        put_rows((number, front), lanes, part.call(side_met, ray, hit, lanes, integrand.no_appearance, image_lanes))
    return number, front


def survivors(integrand: Integrand, state: PathState, step: Step) -> PathState:
    """The states of the lanes that go on to the next bounce, compacted."""
    return Onward(state, surviving(step)).packed(integrand)


def surviving(step: Step) -> Tensor:
    """Indices into `Step.order` of the lanes that go on, int32; they are also indices of vertices."""
    return chosen(step.survives)


class Bounce(NamedTuple):
    """One iteration of the loop over bounces."""

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
        """(K,) the factor of the next vertex's radiance: F_k, 0 where the path ends."""
        return masked(self.step.survives, self.vertex.F)


def bounces(integrand: Integrand, state: PathState, depth: int = 0, steps: Mapping[int, Step] = {},
            hit: Hit | None = None, with_light: bool = True) -> Iterator[Bounce]:
    """Iterates over bounces until every path has ended.

    Args:
        integrand: the scene and how to step.
        state: of the paths that have reached `depth`.
        depth: of the first bounce to take.
        steps: by depth, what was decided before; no ray is cast there.
        hit: of the first rays, if it is known.
        with_light: see `take_step`.
    """
    while depth < integrand.max_depth and len(state.lane):
        vertex, light, step = take_step(integrand, state, depth, steps.get(depth), hit, with_light)
        yield Bounce(depth, state, vertex, light, step)
        state, depth, hit = survivors(integrand, vertex.next, step), depth + 1, None


class Onward(NamedTuple):
    """The paths that go on from a bounce."""

    paths: PathState  # (K,) of the vertices, those that end there among them
    alive: Tensor | None  # (M,) int32, the places of those that go on; None: all do
    hit: Hit | None = None  # (M,) of their rays, if it is known
    number: LaneCount | None = None  # M, if only the device knows it; of `alive` the first are meant

    @property
    def count(self) -> int | LaneCount:
        """M."""
        return len(self.paths.lane if self.alive is None else self.alive) if self.number is None else self.number

    def asked(self, depth: int) -> Onward:
        """The same at `depth`; if only the device knows the number, it is asked now and then, so that there is room for
        fewer from there on."""
        if self.number is None or depth % ASKED:
            return self
        most = min(power_of_2(waited_for(self.number)), self.number.most)
        return self._replace(alive=self.alive[:most], number=self.number._replace(most=most))

    def cut_to_count(self) -> Onward:
        """The same of as many paths as there are; waits for the device if it alone knows."""
        return self if self.number is None else self._replace(alive=self.alive[:waited_for(self.number)], number=None)

    def packed(self, integrand: Integrand) -> PathState:
        """(M,) the states of the paths that go on, compacted."""
        if self.alive is None or len(self.alive) == len(self.paths.lane):
            return self.paths
        return integrand.stages(rows)(self.paths, self.alive)


def bounced(integrand: Integrand, onward: Onward, depth: int, L: Vec3 | None) -> tuple[PathState, Step, Onward]:
    """Takes one bounce of every lane, and adds to the radiance: L += beta_k E_k.

    Args:
        integrand: the scene and how to step.
        onward: the paths that take it.
        depth: of the bounce.
        L: (N,) of all lanes, written into; None: nobody asks for it.

    Returns:
        The paths that reached the bounce, what was decided there, and those that go on.
    """
    state = onward.packed(integrand)
    vertex, light, step = take_step(integrand, state, depth, hit=onward.hit, with_light=L is not None)
    stages, last = integrand.stages, step.queues[-1]
    shown = [queue for queue in step.queues if queue.image and queue.event.scatters]
    if shown and L is not None:
        order, lane, Le, Ld, visible = rows_between((step.order, vertex.next.lane, vertex.Le, vertex.Ld, step.visible),
                                                    shown[0].first, shown[-1].last)
        put_rows(L, lane, stages(brightened)(L, state.beta, order, lane, Le, Ld, visible))
    if light is not None:
        order = step.order[last.first:last.last]
        ended = stages(rows)(state.lane, order)
        put_rows(L, ended, stages(brightened)(L, state.beta, order, ended, light, None, None))
    return state, step, Onward(vertex.next, surviving(step))


@stage("L", "beta")
def brightened(L: Vec3, beta: Vec3, order: Tensor, lane: Tensor, Le: Vec3, Ld: Vec3 | None, visible: Tensor | None) -> Vec3:
    """Adds the contribution beta (Le + visible Ld) of a bounce to the radiance of some lanes.

    Args:
        L: of all lanes of the chunk.
        beta: of the paths that reached the bounce.
        order: (M,) int32, those of them that are meant; the rest is in their order.
        lane: (M,) int32, their places in the chunk.
        Le, Ld, visible: of the bounce; None: nothing is scattered.
    """
    return rows(L, lane) + rows(beta, order) * (Le if Ld is None else gathered(Le, Ld, visible))


def put_rows(record, place: Tensor, entries) -> None:
    """Overwrites the entries at indices `place`, (N,) int32 without repetition, in every tensor of a record."""
    targets, found = ([leaf for leaf in leaves_of(part) if leaf is not None] for part in (record, entries))
    if torch.is_grad_enabled() and any([leaf.requires_grad for leaf in found]):
        for target, new in zip(targets, found):
            target.index_copy_(0, place.long(), new)
    else:
        put(tangents_and_tensors(targets), place, tangents_and_tensors(found))


def radiance_buffer(integrand: Integrand, start: PathState) -> Vec3:
    """(N,) zeros to sum radiance in; dual tensors if the scene or the rays have tangents."""
    L = Vec3.buffer(start.pdf)
    moves = inside_dual_level() and (integrand.attached or any_differentiated(start))
    return dual(L, Vec3.buffer(start.pdf)) if moves else L


def add_at(L: Vec3, lane: Tensor, value: Vec3) -> None:
    """Adds `value` to `L` at indices `lane`, in place."""
    for total, part in zip(L, value):
        total.index_add_(0, lane, part)


def first_hit(integrand: Integrand, ray: Ray, depth: int) -> Hit:
    """The closest hits of rays; of camera rays, the closest visible ones."""
    if depth > 0:
        return integrand.caster.intersect(ray)
    return camera_hit(integrand.caster, integrand.proposal, ray, integrand.clipping, integrand.settings.hide_emitters)
