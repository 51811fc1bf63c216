"""The backward pass of bounces as machine code; see `path/taped_bounces.py`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import torch

from torch_radbp.adjoint.bounce import LanesOfChunk
from torch_radbp.adjoint.outside import ModuleAdjoint
from torch_radbp.adjoint.scatter import Gradients
from torch_radbp.adjoint.sweep import PathRecord, Sweep
from torch_radbp.interface.texture import TextureValue
from torch_radbp.jit.cpu.board import Board, board
from torch_radbp.jit.recording.lane_count import LaneCount
from torch_radbp.jit.recording.recording import Reserve
from torch_radbp.jit.tape import Played, without_contents
from torch_radbp.path.event import Event
from torch_radbp.path.integrand import Integrand
from torch_radbp.path.queues import ALL, APART, Queue
from torch_radbp.path.state import PathState, Position
from torch_radbp.path.step import Onward, Step, surviving
from torch_radbp.path.taped_bounces import recordable, tape_of
from torch_radbp.path.texture_networks import number_outside
from torch_radbp.path.wavefront import take_step
from torch_radbp.scene.tables.scene_tensors import SceneTensors
from torch_radbp.tensors.record import leaves_of
from torch_radbp.tensors.vec import Vec3

TextureValues = tuple[TextureValue, ...] | None
QueueKind = tuple[Event, bool, bool]  # what happens, and whether lanes are of the image, and of the derivative


class TapedSweep(Sweep):
    """A backward sweep that differentiates bounces by recorded machine code where they can be recorded.

    Args:
        board: of the helpers; the rest is a `Sweep`'s.
    """

    def __init__(self, board: Board, integrand: Integrand, record: PathRecord, adj_L: Vec3, numbered: SceneTensors,
                 gradients: Gradients):
        super().__init__(integrand, record, adj_L, numbered, gradients)
        wanted = tuple([number is not None for number in leaves_of(numbered) if number is None or isinstance(number, int)])
        sizes = tuple([(total.shape, total.stride()) for total in gradients.totals])
        sums = [part.data_ptr() for part in (*gradients.totals, *gradients.touched.values())]
        self.tape = tape_of(integrand, adj_L.x.dtype, board, tuple(sums), ("sweep", wanted, sizes))

    def advance(self, state: PathState, depth: int) -> PathState:
        step, integrand = self.record.steps.get(depth), self.integrand
        if self.takes_outside(step, depth):
            self.tape.rest()
            return super().advance(state, depth)

        def advanced(state: PathState, step: Step | None, at: Position) -> Played:
            vertex, _, step = take_step(integrand, state, depth, step, with_light=False)
            onward = Onward(vertex.next, surviving(step))
            return Played(onward.packed(integrand), [len(onward.alive)])

        kinds = () if step is None else self.kinds(step, depth)
        borders = [] if step is None else queue_borders({queue_kind(queue): queue for queue in step.queues}, kinds)
        step = None if step is None else step._replace(queues=(), texture_values=(None,) * len(kinds))

        def blank(arguments: tuple, reserve: Reserve, borders: Sequence[int] = ()) -> tuple:
            state, step, at = arguments
            places = zip(kinds, [0, *borders[1::2]], borders[::2])
            queues = [Queue(event, first, last, *of) for (event, *of), first, last in places]
            return without_contents(state, reserve), None if step is None else in_queues(step, queues, reserve), at

        arguments = state._replace(number=None), step, integrand.at(depth)
        played = self.tape.play(("advance", kinds, *integrand.kind_at(depth)), advanced, arguments, state.count, blank,
                                counts=borders, waits=False)
        if played is None:
            return super().advance(state, depth)
        ahead, (going_on,) = played.results, played.counts
        return ahead._replace(number=going_on) if isinstance(going_on, LaneCount) else ahead

    def takes_outside(self, step: Step | None, depth: int) -> bool:
        """True if replaying a bounce cannot be recorded as a whole: it evaluates networks, or casts camera rays
        repeatedly."""
        return self.integrand.scene.layout.reads_outside or (step is None and depth == 0 and self.integrand.rejects_hits)

    def finish(self) -> None:
        self.tape.rest()
        super().finish()

    def adjoint(self, state: PathState, depth: int) -> None:
        step, integrand = self.record.steps.get(depth), self.integrand
        if step is not None or self.takes_outside(step, depth):
            if step is None:
                self.tape.rest()
            super().adjoint(state, depth)
            return

        def taken_again(state: PathState, chunk: LanesOfChunk, at: Position) -> Played:
            step = take_step(integrand, state, depth, with_light=False)[-1]
            return Played(super(TapedSweep, self).differentiate(state, step, chunk, depth))

        arguments = state._replace(number=None), self.chunk, integrand.at(depth)
        played = self.tape.play(("again", *integrand.kind_at(depth)), taken_again, arguments, state.count, waits=False)
        if played is None:
            super().adjoint(state, depth)

    def differentiate(self, state: PathState, step: Step, chunk: LanesOfChunk, depth: int) -> tuple[ModuleAdjoint, ...]:
        integrand, events = self.integrand, self.integrand.events(depth)
        values = self.known_values(step, events)
        borders = queue_borders({queue.event: queue for queue in step.queues if queue.derivative}, events)

        def blank(arguments: tuple, reserve: Reserve, borders: Sequence[int]) -> tuple:
            *lanes, step, at = arguments
            queues = list(map(Queue, events, [0, *borders[1::2]], borders[::2]))
            return *without_contents(lanes, reserve), in_queues(step, queues, reserve), at

        def differentiated(state: PathState, chunk: LanesOfChunk, step: Step, at: Position) -> Played:
            adjoints = super(TapedSweep, self).differentiate(state, step, chunk, depth)
            return Played(tuple([adjoint._replace(first=None, last=None) for adjoint in adjoints]),
                          [border for adjoint in adjoints for border in (adjoint.first, adjoint.last)])

        arguments = state._replace(number=None), chunk, step._replace(queues=(), texture_values=values), integrand.at(depth)
        name = step.front is None, *[of_queue is None for of_queue in values]
        played = self.tape.play(integrand.kind_at(depth), differentiated, arguments, state.count, blank, name, borders,
                                waits=False)
        if played is None:
            return super().differentiate(state, step, chunk, depth)
        borders = zip(played.counts[::2], played.counts[1::2])
        return tuple([adjoint._replace(first=first, last=last) for adjoint, (first, last) in zip(played.results, borders)])

    def kinds(self, step: Step, depth: int) -> tuple[QueueKind, ...]:
        """The kinds of queues that are possible at a bounce, in the order of their lanes, whether `step` has them or not."""
        apart = any(kind[1:] not in ALL for kind in map(queue_kind, step.queues))
        scatters, ends = ([event for event in self.integrand.events(depth) if event.scatters == on] for on in (True, False))
        return tuple((event, *kind) for events in (scatters, ends) for event, kind in (
            [(event, kind) for kind in (APART if apart else ALL) for event in events]))

    def known_values(self, step: Step, events: Sequence[Event]) -> tuple[TextureValues, ...]:
        """For each event, its network texture values from the forward pass; None: not kept, or not needed."""
        integrand = self.integrand
        if self.moving or not integrand.scene.layout.reads_outside:
            return (None,) * len(events)
        known = {queue.event: values for queue, values in zip(step.queues, step.texture_values) if queue.derivative}
        no_lanes = TextureValue(self.adj_L.map(lambda channel: channel[:0]))

        def values_of(event: Event) -> TextureValues:
            if event in known:
                values = known[event]
                return None if values is None else tuple([TextureValue(texture.value) for texture in values])
            layout = integrand.scene.layout
            return (no_lanes,) * number_outside(layout, integrand.scatterer(event), integrand.settings.nee)

        return tuple(map(values_of, events))


def queue_kind(queue: Queue) -> QueueKind:
    """The event of a queue, and whether its lanes count in the image and in the derivative."""
    return queue.event, queue.image, queue.derivative


def queue_borders(queues: Mapping[Any, Queue], kinds: Sequence[Any]) -> list[int | LaneCount]:
    """The borders of queues of given kinds: end of the first, start and end of the second, ...; missing queues are empty."""
    borders, last = [], 0
    for kind in kinds:
        queue = queues.get(kind)
        borders += [last, last] if queue is None else [queue.first, last := queue.last]
    return borders[1:]


def in_queues(step: Step, queues: Sequence[Queue], reserve: Reserve) -> Step:
    """The decisions of a bounce with given queues, as tensors without contents, for recording."""
    hit, front, picked, flight = without_contents((step.hit, step.front, step.picked, step.flight), reserve)
    scattered = [0, *(queue.last for queue in queues if queue.event.scatters)][-1]
    values = tuple([without_contents(values, reserve, queue.last - queue.first)
                    for queue, values in zip(queues, step.texture_values)])
    visible, survives = (reserve.tensor(torch.bool, scattered) for _ in range(2))
    return Step(hit, front, reserve.tensor(torch.int32, queues[-1].last), tuple(queues), visible, survives, picked, flight,
                values, without_contents(step.shadow_way, reserve, scattered))


@contextmanager
def sweep_of(integrand: Integrand, *arguments) -> Iterator[Sweep]:
    """Yields a sweep, which runs recorded machine code where possible; on exit all gradients are complete."""
    if not recordable(integrand):
        yield (sweep := Sweep(integrand, *arguments))
        sweep.finish()
        return
    with board() as helpers:
        yield (sweep := TapedSweep(helpers, integrand, *arguments))
        sweep.finish()
