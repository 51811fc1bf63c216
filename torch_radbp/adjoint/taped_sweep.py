"""The backward pass of bounces as machine code; see `path/taped_bounces.py`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import torch

from torch_radbp.adjoint.bounce import Memo
from torch_radbp.adjoint.outside import ModuleAdjoint
from torch_radbp.adjoint.scatter import Gradients
from torch_radbp.adjoint.sweep import PathRecord, Sweep
from torch_radbp.jit.board import Board, board
from torch_radbp.jit.recording import Reserve
from torch_radbp.jit.tape import Played, without_contents
from torch_radbp.path.event import Ends, Event, Scatters
from torch_radbp.path.integrand import Integrand
from torch_radbp.path.queues import Queue
from torch_radbp.path.state import PathState, Position
from torch_radbp.path.taped_bounces import recordable, tape_of
from torch_radbp.path.texture_networks import number_outside
from torch_radbp.path.wavefront import Step
from torch_radbp.scene.tensors import SceneTensors
from torch_radbp.tensors.record import leaves_of
from torch_radbp.tensors.vec import Vec3
from torch_radbp.texture.reader import TextureValue

TextureValues = tuple[TextureValue, ...] | None


class TapedSweep(Sweep):
    """A sweep that differentiates bounces by machine code where they can be recorded.

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
        self.tape.rest()
        return super().advance(state, depth)

    def finish(self) -> None:
        self.tape.rest()
        super().finish()

    def adjoint(self, state: PathState, depth: int) -> None:
        if depth not in self.record.steps:
            self.tape.rest()
        super().adjoint(state, depth)

    def differentiate(self, state: PathState, step: Step, memo: Memo, adj_L: Vec3, depth: int) -> tuple[ModuleAdjoint, ...]:
        events, integrand = self.events(depth), self.integrand
        values = self.known_values(step, events)
        queues, borders, last = {queue.event: queue for queue in step.queues if queue.derivative}, [], 0
        for event in events:
            queue = queues.get(event)
            borders += [last, last] if queue is None else [queue.first, last := queue.last]

        def blank(arguments: tuple, reserve: Reserve, borders: Sequence[int]) -> tuple:
            *lanes, step, at = arguments
            *lanes, hit, front, picked = without_contents((*lanes, step.hit, step.front, step.picked), reserve)
            step = step._replace(hit=hit, front=front, picked=picked,
                                 queues=tuple(map(Queue, events, borders[::2], borders[1::2])))
            return *lanes, in_queues(step, reserve), at

        def differentiated(state: PathState, memo: Memo, adj_L: Vec3, step: Step, at: Position) -> Played:
            return Played(super(TapedSweep, self).differentiate(state, step, memo, adj_L, depth))

        arguments = (state._replace(number=None), memo, adj_L, step._replace(queues=(), texture_values=values),
                     integrand.at(depth))
        name = step.front is None, *[of_queue is None for of_queue in values]
        played = self.tape.play(integrand.kind_at(depth), differentiated, arguments, state.count, blank, name, borders,
                                waits=False)
        return super().differentiate(state, step, memo, adj_L, depth) if played is None else played.results

    def events(self, depth: int) -> list[Event]:
        """What may happen at a bounce."""
        layout = self.integrand.proposal.layout
        if self.integrand.is_last(depth):
            return [Ends.LAST_BOUNCE]
        return [*map(Scatters, range(len(layout.appearances))), *([] if layout.surround is None else [Ends.SURROUNDINGS])]

    def known_values(self, step: Step, events: list[Event]) -> tuple[TextureValues, ...]:
        """The values of textures that were read outside, for each of the events; None: not known, or not asked for."""
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


def in_queues(step: Step, reserve: Reserve) -> Step:
    """What was decided at a bounce with what belongs to its queues, without contents."""
    scattered = [0, *(queue.last for queue in step.queues if queue.event.scatters)][-1]
    values = tuple([without_contents(values, reserve, queue.last - queue.first)
                    for queue, values in zip(step.queues, step.texture_values)])
    return step._replace(order=reserve.tensor(torch.int32, step.queues[-1].last), texture_values=values,
                         visible=reserve.tensor(torch.bool, scattered), survives=reserve.tensor(torch.bool, scattered))


@contextmanager
def sweep_of(integrand: Integrand, *arguments) -> Iterator[Sweep]:
    """The `Sweep` with these arguments, whose bounces are differentiated by machine code where that is possible; all
    gradients are complete afterwards."""
    if not recordable(integrand):
        yield (sweep := Sweep(integrand, *arguments))
        sweep.finish()
        return
    with board() as helpers:
        yield (sweep := TapedSweep(helpers, integrand, *arguments))
        sweep.finish()
