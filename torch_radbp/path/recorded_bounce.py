"""Bounces as machine code: what a bounce does with lanes is recorded once for scenes of one kind, and then done again.

Between the loops of a bounce Python would decide which comes next, with what. It does so once, in `wavefront.bounced`, while
a `jit.Recording` listens. What differs from call to call and from depth to depth, tables and numbers, is given to what was
recorded.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from threading import Lock
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torch_radbp.jit.board import Board, board
from torch_radbp.jit.dual import dual, parted, tensors_of
from torch_radbp.jit.recorded import Given, Recorded
from torch_radbp.jit.recording import ALL, NotRecordable, Recording, Reserve, listening
from torch_radbp.jit.structure import flatten
from torch_radbp.path.integrand import Integrand
from torch_radbp.path.queues import EMPTY, Queue
from torch_radbp.path.state import PathState
from torch_radbp.path.wavefront import Onward, Step, bounced, first_hit
from torch_radbp.tensors.differentiated import detached
from torch_radbp.tensors.record import leaves_of, with_leaves
from torch_radbp.tensors.torch_internals import inside_dual_level
from torch_radbp.tensors.vec import Vec3

Bounce = Callable[[Integrand, Onward, int, Vec3 | None], tuple[PathState, Step, Onward]]  # `bounced`, or one that is like it
BounceOf = Callable[[Onward, int, Vec3 | None], tuple[PathState, Step, Onward]]  # the same of an integrand
MOST = 256  # recordings that are kept
UNKNOWN = object()


class QueueOfCounts(NamedTuple):
    """A `Queue`, of which is known which counts of the recording tell its lanes."""

    queue: Queue
    first: int
    last: int

    def among(self, counts: Sequence[int]) -> Queue:
        """The queue for counts that were found."""
        return self.queue._replace(first=counts[self.first], last=counts[self.last])


class RecordedBounce(NamedTuple):
    """A bounce that was recorded."""

    recorded: Recorded  # of the paths that reach it, what `Step` has of them but its queues, and those that go on
    queues: tuple[QueueOfCounts, ...]
    dual: bool  # the results are values and, by themselves, tangents


class Recordings:
    """What was recorded, by all that it depends on; None: such things cannot be."""

    def __init__(self) -> None:
        self.known: dict[tuple, Any] = {}
        self.kinds: dict[tuple, int] = {}
        self.making, self.numbers = Lock(), itertools.count()

    def kind(self, *parts) -> int:
        """A number that stands for these parts of a key, which take their time to compare; they are kept alive."""
        return self.kinds.setdefault(parts, next(self.numbers))

    def of(self, key: tuple, make: Callable[[], Any]) -> Any:
        """What a key stands for, recorded now if it is not known."""
        found = self.known.get(key, UNKNOWN)
        if found is UNKNOWN:
            with self.making:
                found = self.known.get(key, UNKNOWN)
                if found is UNKNOWN:
                    if len(self.known) >= MOST:
                        self.known.pop(next(iter(self.known)))
                    found = self.known[key] = make()
        return found


RECORDINGS = Recordings()


class Tables:
    """What recorded bounces of one integrand read beside paths.

    Args:
        integrand: the scene and how to step.
        dtype: of the rays.
    """

    def __init__(self, integrand: Integrand, dtype: torch.dtype):
        caster = integrand.caster
        scene = tensors_of(integrand.scene)
        numbers = [integrand.no_appearance, *([] if integrand.differentiated is None else [integrand.differentiated])]
        self.given = Given([*numbers, *scene, *(() if caster is None else caster.reads(dtype))])
        present = [part is not None for part in (integrand.clipping, integrand.differentiated, *(
            getattr(caster, name, None) for name in ("balls", "instances")))]
        # Stages have the code that recordings call.
        self.kind = RECORDINGS.kind(integrand.stages, integrand.proposal.layout, type(caster), *present,
                                    self.given.pattern, lying(scene), moving_leaves(integrand))


class Recorder:
    """Takes the bounces of one trace, by machine code where they can be recorded.

    Args:
        bounce: takes one.
        integrand: the scene and how to step.
        board: of the helpers.
        dtype: of the rays.
    """

    def __init__(self, bounce: Bounce, integrand: Integrand, board: Board, dtype: torch.dtype):
        self.bounce, self.integrand, self.board, self.tables = bounce, integrand, board, Tables(integrand, dtype)
        self.kind: int | None = None  # of the bounces after the first

    def __call__(self, onward: Onward, depth: int, L: Vec3 | None) -> tuple[PathState, Step, Onward]:
        """As `bounced`."""
        integrand = self.integrand
        if depth == 0 and onward.hit is None and integrand.rejects_hits:
            self.board.close()
            onward = with_first_hit(integrand, onward)  # who knows how many rays it casts
        varying = Given(tensors_of((onward, L, integrand.at(depth))))
        kind = self.kind if onward.hit is None and onward.alive is not None else None
        if kind is None:
            kind = RECORDINGS.kind(self.bounce, self.tables.kind, *structure_of((onward, L)))
            same = onward.hit is None and onward.alive is not None and not inside_dual_level()
            self.kind = kind if same else None
        key = kind, varying.pattern, integrand.settings_at(depth), integrand.is_last(depth), depth == 0
        made = None
        if all([leaf.is_contiguous() for leaf in varying.items]):
            made = RECORDINGS.of(key, partial(self.record, onward, depth, L))
        if made is None:
            self.board.close()
            return self.bounce(integrand, onward, depth, L)
        found, counts = made.recorded(varying, self.tables.given, onward.count, self.board, contexts=(integrand.scene,))
        state, hit, front, order, visible, survives, picked, values, onward = dual(*found) if made.dual else found
        integrand.caster.count(sum([counts[last] - counts[first] for first, last in made.recorded.rays]))
        queues = [(queue, own) for queue, own in zip([queue.among(counts) for queue in made.queues], values)
                  if queue.last > queue.first]
        queues, values = zip(*queues) if queues else ((EMPTY,), ((),))
        step = Step(hit, front, order, queues, visible, survives, picked, values)
        return state, step, onward

    def record(self, onward: Onward, depth: int, L: Vec3 | None) -> RecordedBounce | None:
        """Records a bounce like this one; None if that is not possible."""
        integrand = self.integrand
        reserve = Reserve()
        onward, L = lanes_without_contents(onward, L, reserve)
        given = [*tensors_of((onward, L, integrand.at(depth))), *self.tables.given.items]
        listener = Recording(given, reserve=reserve, contexts=(integrand.scene,))
        try:
            with torch.no_grad(), listening(listener):
                state, step, onward = self.bounce(integrand, onward, depth, L)
            results = (state, step.hit, step.front, step.order, step.visible, step.survives, step.picked,
                       step.texture_values, onward)
            results = parted(results) if inside_dual_level() else results
            queues = tuple(QueueOfCounts(queue, listener.points[queue.first], listener.points[queue.last])
                           for queue in step.queues)
            return RecordedBounce(Recorded(listener, given, results), queues, inside_dual_level())
        except NotRecordable:
            return None


def recorded(given: Sequence[Tensor | int], reserve: Reserve, function: Callable[[], Any]) -> Recorded | None:
    """What a function does with what it is given, and returns, recorded; None if that is not possible.

    Args:
        given: all that it reads; what has an entry for each lane is without contents.
        reserve: from which such is.
        function: nested tuples of tensors are returned.
    """
    listener = Recording(given, reserve=reserve)
    try:
        with torch.no_grad(), listening(listener):
            found = function()
        return Recorded(listener, given, found)
    except NotRecordable:
        return None


def without_contents(record, reserve: Reserve, lanes: int = ALL):
    """A record of lanes like another one, as recordings have them; what is the same there is so here."""
    made: dict[int, Tensor] = {}
    return dual(*[with_leaves(part, [None if leaf is None else made.setdefault(
        leaf.data_ptr(), reserve.tensor(leaf.dtype, lanes)) for leaf in leaves_of(part)]) for part in parted(record)])


def lanes_without_contents(onward: Onward, L: Vec3 | None, reserve: Reserve) -> tuple[Onward, Vec3 | None]:
    """The same of what a bounce is given."""
    paths = without_contents(onward.paths, reserve, ALL if onward.alive is None else ALL + 1)  # of which some end
    alive, hit, L = without_contents((onward.alive, onward.hit, L), reserve)
    return Onward(paths, alive, hit), L


def structure_of(record) -> list:
    """What is there and what is not, tangents among it; equal of what one recording serves."""
    structure: list = []
    flatten(parted(record) if inside_dual_level() else record, [], structure)
    return structure


def with_first_hit(integrand: Integrand, onward: Onward) -> Onward:
    """Camera paths with what their rays meet."""
    return onward._replace(hit=first_hit(integrand, detached(onward.packed(integrand).ray), 0))


def moving_leaves(integrand: Integrand) -> tuple[int, ...]:
    """Which leaves of the scene have tangents."""
    tangents = leaves_of(parted(integrand.scene)[1]) if integrand.attached else ()
    return tuple([place for place, tangent in enumerate(tangents) if tangent is not None])


def lying(tables: Sequence[Tensor]) -> tuple:
    """How tables lie in memory, as far as code depends on that."""
    blocks: dict[tuple, int] = {}  # of rows that several are columns of
    found = []
    for table in tables:
        if table.is_contiguous():
            found.append((table.dtype, table.dim()))
        else:
            width, offset = table.stride(0), table.storage_offset()
            block = table.untyped_storage().data_ptr(), offset // width, width
            found.append((table.dtype, width, offset % width, blocks.setdefault(block, len(blocks))))
    return tuple(found)


@contextmanager
def bounces_taken(integrand: Integrand, dtype: torch.dtype, bounce: Bounce = bounced) -> Iterator[BounceOf]:
    """What takes one bounce after the other, of rays of a dtype: `bounce`, or machine code that does the same."""
    if not recordable(integrand):
        yield partial(bounce, integrand)
        return
    with board() as own:
        yield Recorder(bounce, integrand, own, dtype)


def recordable(integrand: Integrand) -> bool:
    """True if bounces may be recorded: those of compiled stages, on the CPU, which autograd does not record. Who is asked
    outside is told no tangents."""
    return (integrand.stages.is_compiled and not (integrand.attached and torch.is_grad_enabled())
            and not (integrand.proposal.layout.reads_outside and inside_dual_level())
            and (integrand.caster is None or hasattr(integrand.caster, "reads"))
            and integrand.proposal.lights.choice.pmf.device.type == "cpu")
