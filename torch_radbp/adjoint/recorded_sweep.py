"""The backward pass of bounces as machine code; see `path/recorded_bounce.py`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from copy import copy
from functools import partial

import torch

from torch_radbp.adjoint.scatter import Gradients
from torch_radbp.adjoint.sweep import PathRecord, Sweep
from torch_radbp.jit.board import board
from torch_radbp.jit.recorded import Given, Recorded
from torch_radbp.jit.recording import ALL, NotRecordable, Recording, Reserve, listening
from torch_radbp.jit.structure import flatten
from torch_radbp.path.event import Ends, Event, Scatters
from torch_radbp.path.integrand import Integrand
from torch_radbp.path.queues import Queue
from torch_radbp.path.recorded_bounce import RECORDINGS, Tables, recordable, tensors_of, without_contents
from torch_radbp.path.state import PathState
from torch_radbp.path.wavefront import Step
from torch_radbp.scene.tensors import SceneTensors
from torch_radbp.tensors.record import leaves_of
from torch_radbp.tensors.vec import Vec3


class RecordedSweep(Sweep):
    """A sweep that differentiates bounces by machine code where they can be recorded.

    Args:
        board: of the helpers; the rest is a `Sweep`'s.
    """

    def __init__(self, board: int, integrand: Integrand, record: PathRecord, adj_L: Vec3, numbered: SceneTensors,
                 gradients: Gradients):
        super().__init__(integrand, record, adj_L, numbered, gradients)
        tables = Tables(integrand, adj_L.x.dtype)
        wanted = tuple([number is not None for number in leaves_of(numbered) if number is None or isinstance(number, int)])
        totals = gradients.totals
        sums = [part.data_ptr() for part in (*totals, *gradients.touched.values())]
        sizes = wanted, tuple([(total.shape, total.stride()) for total in totals])
        self.board, self.others, self.tables = board, Given([*tables.given.items, *sums]), (tables.kind, sizes)
        self.kind: int | None = None  # of bounces

    def differentiate(self, state: PathState, step: Step, depth: int) -> None:
        events, integrand = self.events(depth), self.integrand
        lanes = tensors_of((state, step.hit, step.front, step.order, step.visible, step.survives))
        varying = Given([*lanes, *tensors_of((self.memo, self.adj_L, integrand.at(depth)))])
        if self.kind is None:
            structure: list = []
            flatten((state, step.hit, self.memo, self.adj_L), [], structure)
            self.kind = RECORDINGS.kind(*self.tables, *structure)
        key = (self.kind, varying.pattern, step.front is None, integrand.settings_at(depth),
               integrand.is_last(depth), depth == 0)
        made = None
        if all([leaf.is_contiguous() for leaf in lanes]):
            made = RECORDINGS.of(key, partial(self.record_bounce, state, step, depth, events))
        if made is None:
            super().differentiate(state, step, depth)
            return
        queues, borders, last = {queue.event: queue for queue in step.queues if queue.derivative}, [], 0
        for event in events:
            queue = queues.get(event)
            borders += [last, last] if queue is None else [queue.first, last := queue.last]
        made(varying, self.others, len(state.lane), self.board, borders)

    def events(self, depth: int) -> list[Event]:
        """What may happen at a bounce."""
        layout = self.integrand.proposal.layout
        if self.integrand.is_last(depth):
            return [Ends.LAST_BOUNCE]
        return [*map(Scatters, range(len(layout.appearances))), *([] if layout.surround is None else [Ends.SURROUNDINGS])]

    def record_bounce(self, state: PathState, step: Step, depth: int, events: list[Event]) -> Recorded | None:
        """Records the derivatives of such a bounce; None if that is not possible."""
        borders = Recording([]).borders(2 * len(events) + 1, ALL)[1:-1]
        queues = tuple(map(Queue, events, borders[::2], borders[1::2]))
        lanes, scattered = queues[-1].last, [0, *(queue.last for queue in queues if queue.event.scatters)][-1]
        reserve, other = Reserve(), copy(self)
        state, hit, front = without_contents((state, step.hit, step.front), reserve)
        step = step._replace(hit=hit, front=front, order=reserve.tensor(torch.int32, lanes), queues=queues,
                             visible=reserve.tensor(torch.bool, scattered), survives=reserve.tensor(torch.bool, scattered),
                             texture_values=((),) * len(queues))
        other.memo, other.adj_L = without_contents((self.memo, self.adj_L), reserve)
        given = [*tensors_of((state, hit, front, step.order, step.visible, step.survives)),
                 *tensors_of((other.memo, other.adj_L, self.integrand.at(depth))), *self.others.items]
        listener = Recording(given, borders, reserve)
        try:
            with torch.no_grad(), listening(listener):
                Sweep.differentiate(other, state, step, depth)
            return Recorded(listener, given, ())
        except NotRecordable:
            return None


@contextmanager
def sweep_of(integrand: Integrand, *arguments) -> Iterator[Sweep]:
    """The `Sweep` with these arguments, whose bounces are differentiated by machine code where that is possible."""
    if not recordable(integrand):
        yield Sweep(integrand, *arguments)
        return
    with board() as address:
        yield RecordedSweep(address, integrand, *arguments)
