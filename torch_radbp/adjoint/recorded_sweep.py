"""The backward pass of bounces as machine code; see `path/recorded_bounce.py`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from copy import copy
from functools import partial

import torch

from torch_radbp.adjoint.outside import ModuleAdjoint
from torch_radbp.adjoint.scatter import Gradients
from torch_radbp.adjoint.sweep import PathRecord, Sweep
from torch_radbp.jit.board import Board, board
from torch_radbp.jit.dual import tensors_of
from torch_radbp.jit.recorded import Given, Recorded
from torch_radbp.jit.recording import ALL, NotRecordable, Recording, Reserve, listening
from torch_radbp.jit.structure import flatten
from torch_radbp.path.event import Ends, Event, Scatters
from torch_radbp.path.integrand import Integrand
from torch_radbp.path.queues import Queue
from torch_radbp.path.recorded_bounce import RECORDINGS, Tables, recordable, without_contents
from torch_radbp.path.state import PathState
from torch_radbp.path.texture_networks import number_outside
from torch_radbp.path.wavefront import Step
from torch_radbp.scene.tensors import SceneTensors
from torch_radbp.tensors.record import leaves_of
from torch_radbp.tensors.vec import Vec3
from torch_radbp.texture.reader import TextureValue


class RecordedSweep(Sweep):
    """A sweep that differentiates bounces by machine code where they can be recorded.

    Args:
        board: of the helpers; the rest is a `Sweep`'s.
    """

    def __init__(self, board: Board, integrand: Integrand, record: PathRecord, adj_L: Vec3, numbered: SceneTensors,
                 gradients: Gradients):
        super().__init__(integrand, record, adj_L, numbered, gradients)
        tables = Tables(integrand, adj_L.x.dtype)
        wanted = tuple([number is not None for number in leaves_of(numbered) if number is None or isinstance(number, int)])
        totals = gradients.totals
        sums = [part.data_ptr() for part in (*totals, *gradients.touched.values())]
        sizes = wanted, tuple([(total.shape, total.stride()) for total in totals])
        self.board, self.others, self.tables = board, Given([*tables.given.items, *sums]), (tables.kind, sizes)
        self.kind: int | None = None  # of bounces

    def advance(self, state: PathState, depth: int) -> PathState:
        self.board.close()
        return super().advance(state, depth)

    def finish(self) -> None:
        self.board.close()
        super().finish()

    def adjoint(self, state: PathState, depth: int) -> None:
        if depth not in self.record.steps:
            self.board.close()
        super().adjoint(state, depth)

    def differentiate(self, state: PathState, step: Step, depth: int) -> tuple[ModuleAdjoint, ...]:
        events, integrand = self.events(depth), self.integrand
        lanes = tensors_of((state, step.hit, step.front, step.picked, step.order, step.visible, step.survives))
        varying = Given([*lanes, *tensors_of((self.memo, self.adj_L, integrand.at(depth)))])
        known = self.known_values(step, events)
        values = tensors_of(known)
        if self.kind is None:
            structure: list = []
            flatten((state, step.hit, step.picked, self.memo, self.adj_L), [], structure)
            self.kind = RECORDINGS.kind(*self.tables, *structure)
        key = (self.kind, varying.pattern, step.front is None, integrand.settings_at(depth), integrand.is_last(depth),
               depth == 0, tuple([own is None for own in known]))
        made = None
        if all([leaf.is_contiguous() for leaf in (*lanes, *values)]):
            made = RECORDINGS.of(key, partial(self.record_bounce, state, step, depth, events, known))
        if made is None:
            self.board.close()
            return super().differentiate(state, step, depth)
        queues, borders, last = {queue.event: queue for queue in step.queues if queue.derivative}, [], 0
        for event in events:
            queue = queues.get(event)
            borders += [last, last] if queue is None else [queue.first, last := queue.last]
        varying = Given([*varying.items, *values]) if values else varying
        asked_of_modules, _ = made(varying, self.others, len(state.lane), self.board, borders, (integrand.scene,))
        return asked_of_modules

    def events(self, depth: int) -> list[Event]:
        """What may happen at a bounce."""
        layout = self.integrand.proposal.layout
        if self.integrand.is_last(depth):
            return [Ends.LAST_BOUNCE]
        return [*map(Scatters, range(len(layout.appearances))), *([] if layout.surround is None else [Ends.SURROUNDINGS])]

    def known_values(self, step: Step, events: list[Event]) -> list[tuple[Vec3, ...] | None]:
        """The values of textures that were read outside, for each of the events; None: not known, or not asked for."""
        integrand = self.integrand
        if self.moving or not integrand.scene.layout.reads_outside:
            return [None] * len(events)
        found, nothing = [], self.adj_L.map(lambda channel: channel[:0])
        known = {queue.event: values for queue, values in zip(step.queues, step.texture_values) if queue.derivative}
        for event in events:
            if event in known:
                values = known[event]
                found.append(None if values is None else tuple([texture.value for texture in values]))
            else:
                number = number_outside(integrand.scene.layout, integrand.scatterer(event), integrand.settings.nee)
                found.append((nothing,) * number)
        return found

    def record_bounce(self, state: PathState, step: Step, depth: int, events: list[Event],
                      known: list[tuple[Vec3, ...] | None]) -> Recorded | None:
        """Records the derivatives of such a bounce; None if that is not possible."""
        borders = Recording([]).borders(2 * len(events) + 1, ALL)[1:-1]
        queues = tuple(map(Queue, events, borders[::2], borders[1::2]))
        lanes, scattered = queues[-1].last, [0, *(queue.last for queue in queues if queue.event.scatters)][-1]
        reserve, other = Reserve(), copy(self)
        texture_values = tuple([
            None if values is None else tuple([TextureValue(Vec3(*[reserve.tensor(channel.dtype, queue.last - queue.first)
                                                                   for channel in value])) for value in values])
            for queue, values in zip(queues, known)])
        state, hit, front, picked = without_contents((state, step.hit, step.front, step.picked), reserve)
        step = Step(hit, front, reserve.tensor(torch.int32, lanes), queues, reserve.tensor(torch.bool, scattered),
                    reserve.tensor(torch.bool, scattered), picked, texture_values)
        other.memo, other.adj_L = without_contents((self.memo, self.adj_L), reserve)
        given = [*tensors_of((state, hit, front, picked, step.order, step.visible, step.survives)),
                 *tensors_of((other.memo, other.adj_L, self.integrand.at(depth))), *tensors_of(texture_values),
                 *self.others.items]
        listener = Recording(given, borders, reserve, (self.integrand.scene,))
        try:
            with torch.no_grad(), listening(listener):
                asked_of_modules = Sweep.differentiate(other, state, step, depth)
            return Recorded(listener, given, asked_of_modules)
        except NotRecordable:
            return None


@contextmanager
def sweep_of(integrand: Integrand, *arguments) -> Iterator[Sweep]:
    """The `Sweep` with these arguments, whose bounces are differentiated by machine code where that is possible; all
    gradients are complete afterwards."""
    if not recordable(integrand):
        yield (sweep := Sweep(integrand, *arguments))
        sweep.finish()
        return
    with board() as own:
        yield (sweep := RecordedSweep(own, integrand, *arguments))
        sweep.finish()
