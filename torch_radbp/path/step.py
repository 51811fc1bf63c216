"""What was decided at a bounce, and the paths that go on from it."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor

from torch_radbp.interface.texture import TextureValue
from torch_radbp.jit.order import chosen
from torch_radbp.jit.recording.lane_count import LaneCount, waited_for
from torch_radbp.path.integrand import Integrand
from torch_radbp.path.lane_room import ASKED, power_of_2
from torch_radbp.path.queues import EMPTY, Queue
from torch_radbp.path.state import Arrival, Flight, PathState, ShadowWay
from torch_radbp.raycast.protocol import Hit
from torch_radbp.scene.tables.light_choice import LightPick
from torch_radbp.tensors.record import rows_between
from torch_radbp.tensors.vec import rows


class Step(NamedTuple):
    """The decisions of a bounce: hits, queues, visibility and survival, to be repeated without casting rays.

    Whoever repeats the bounce goes by this record, so that all agree even where rounding would decide otherwise (of
    another device, another number of threads, a compiled function and an eager one).
    """

    hit: Hit  # (N,) of the paths that reach the bounce
    front: Tensor | None  # (N,) bool, see `Arrival`
    order: Tensor  # (M,) int32, these paths sorted by queue; those without surface or light are left out
    queues: tuple[Queue, ...]
    visible: Tensor  # (K,) bool: the shadow ray was free; of the first K of `order`, which scatter
    survives: Tensor  # (K,) bool: the path goes on
    picked: LightPick | None = None  # (N,) None: lights are selected by constant probabilities
    flight: Flight | None = None  # (N,) see `Arrival`
    # Of each queue those of textures that are read outside; None: not computed. In a forward pass attached to the scene.
    texture_values: tuple[tuple[TextureValue, ...] | None, ...] = ()
    shadow_way: ShadowWay | None = None  # (K,) None: rays are not followed through media

    @property
    def scattered(self) -> int:
        """K, the number of lanes that scatter at the bounce."""
        return next((queue.first for queue in self.queues if not queue.event.scatters), self.queues[-1].last)

    def arrival(self, state: PathState) -> Arrival:
        """The paths that reach the bounce, with their hits."""
        return Arrival(state, self.hit, self.front, self.picked, self.flight)


def cut_to_count(state: PathState, step: Step | None) -> tuple[PathState, Step | None]:
    """A path state and its step without unused lanes; waits for the device if it alone knows the number of lanes."""
    state = state.cut_to_count()
    if step is None or not isinstance(step.queues[-1].last, LaneCount):
        return state, step
    counts = step.queues[-1].last.counts.tolist()
    borders = [(counts[queue.first.number], counts[queue.last.number]) for queue in step.queues]
    found = [(queue._replace(first=first, last=last), rows_between(values, first, last))
             for queue, values, (first, last) in zip(step.queues, step.texture_values, borders)]
    queues, values = zip(*([each for each in found if each[0].first < each[0].last] or [(EMPTY, ())]))
    hit, front, picked, flight = rows_between((step.hit, step.front, step.picked, step.flight), 0, len(state.lane))
    of_scattered = step.visible, step.survives, step.shadow_way
    step = Step(hit, front, step.order[:queues[-1].last], queues, step.visible, step.survives, picked, flight, values)
    visible, survives, shadow_way = rows_between(of_scattered, 0, step.scattered)
    return state, step._replace(visible=visible, survives=survives, shadow_way=shadow_way)


def survivors(integrand: Integrand, state: PathState, step: Step) -> PathState:
    """The states of the lanes that go on to the next bounce, compacted."""
    return Onward(state, surviving(step)).packed(integrand)


def surviving(step: Step) -> Tensor:
    """The places of the lanes that go on, int32, in the order into which the step has put lanes, as its vertices are."""
    return chosen(step.survives)


class Onward(NamedTuple):
    """The paths that go on from a bounce to the next."""

    paths: PathState  # (K,) of the vertices, those that end there among them
    alive: Tensor | None  # (M,) int32, the places of those that go on; None: all do
    hit: Hit | None = None  # (M,) of their rays, if it is known
    number: LaneCount | None = None  # M, if only the device knows it; of `alive` the first are meant
    flight: Flight | None = None  # (M,) if it is known how these rays come to `hit` through media

    @property
    def count(self) -> int | LaneCount:
        """M, the number of paths that go on."""
        return len(self.paths.lane if self.alive is None else self.alive) if self.number is None else self.number

    def with_less_room(self, depth: int) -> Onward:
        """The paths in less memory, where only the device knows their number; waits for that at every `ASKED`-th depth."""
        if self.number is None or depth % ASKED:
            return self
        most = min(power_of_2(waited_for(self.number)), self.number.most)
        return self._replace(alive=self.alive[:most], number=self.number._replace(most=most))

    def cut_to_count(self) -> Onward:
        """The paths without unused lanes; waits for the device if it alone knows their number."""
        return self if self.number is None else self._replace(alive=self.alive[:waited_for(self.number)], number=None)

    def packed(self, integrand: Integrand) -> PathState:
        """The states of the paths that go on, (M,), compacted."""
        if self.alive is None or len(self.alive) == len(self.paths.lane):
            return self.paths
        return integrand.stages(rows)(self.paths, self.alive)
