"""A tape: what a step does with lanes is recorded once for arguments of one kind, and done again as machine code: of the
processor, or as launches of a GPU, see `cpu/recorded.py` and `nvidia/launches.py`.

    tape = Tape(board, tables, kind)
    played = tape.play(key, step, arguments, count)     # the first call of a kind records, later ones only play

Between the loops of a step Python would decide which comes next. It does so once, while a `Recording` listens.
What differs from call to call, lanes, numbers of lanes and tables, is given to what was recorded. Recordings are kept for
the process, by all that they depend on.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Hashable, Sequence
from functools import partial
from threading import Lock
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torch_radbp.jit.cpu.board import Board
from torch_radbp.jit.cpu.recorded import Recorded
from torch_radbp.jit.dual import dual, tangents_and_tensors, values_and_tangents
from torch_radbp.jit.nvidia.recorded_launches import RecordedLaunches
from torch_radbp.jit.recording.lane_count import LaneCount, most_of
from torch_radbp.jit.recording.recording import ALL, NotRecordable, Recording, Reserve, listening
from torch_radbp.jit.recording.repetitions import Repetitions
from torch_radbp.jit.recording.results import RecordedInputs
from torch_radbp.jit.recording.structure import flatten
from torch_radbp.jit.target import Target, target_of
from torch_radbp.jit.tiles import Handed, handed
from torch_radbp.tensors.record import leaves_of, with_leaves
from torch_radbp.tensors.torch_internals import inside_dual_level

MOST = 256  # recordings that are kept
UNKNOWN = object()


class Played(NamedTuple):
    """The results of a step, recorded or replayed."""

    results: Any  # tensors in nested tuples; dual ones of dual arguments
    counts: Sequence[int | LaneCount] = ()  # numbers of lanes, or where among lanes something begins
    constant: Any = None  # what is the same whenever this recording is played


Step = Callable[..., Played]  # of the arguments


class Taped(NamedTuple):
    """A recorded step, with what playing it returns beside tensors: counts of lanes and constants."""

    recorded: Recorded | RecordedLaunches
    counts: tuple[int, ...]  # the numbers of `Played.counts` among those of the recording
    constant: Any
    dual: bool  # results are values and, separately, tangents


class Link(NamedTuple):
    """A recorded step whose results are the inputs of the next recorded step, for the same tile of lanes."""

    recorded: Recorded
    handed: Handed
    results: tuple[Any, Any]  # values and tangents without contents: dual tensors do not outlive a call


class Recordings:
    """A cache of recordings by keys of all that they depend on; None for what cannot be recorded."""

    def __init__(self) -> None:
        self.known: dict[tuple, Any] = {}
        self.kinds: dict[tuple, int] = {}
        self.making, self.numbers = Lock(), itertools.count()

    def kind(self, *parts) -> int:
        """A number that stands for parts of a key that are slow to compare; the parts are kept alive."""
        return self.kinds.setdefault(parts, next(self.numbers))

    def of(self, key: tuple, make: Callable[[], Any]) -> Any:
        """The recording of a key, made now if it is missing."""
        made = self.known.get(key, UNKNOWN)
        if made is UNKNOWN:
            with self.making:
                made = self.known.get(key, UNKNOWN)
                if made is UNKNOWN:
                    if len(self.known) >= MOST:
                        self.known.pop(next(iter(self.known)))
                    made = self.known[key] = make()
        return made


RECORDINGS = Recordings()


class Tape:
    """Records and replays steps that read the same tables.

    Args:
        tables: tensors, and addresses, that steps read beside their arguments; another scene brings others of its own.
        kind: all else on which steps depend.
        contexts: of steps' work outside of machine code, see `recording.outside`.
        board: of the helper threads; None: on the CPU nothing is played, only recorded.
        caster: casts the steps' rays; None: none are cast.
        target: on which steps are played; None: that of the device of the tables.
        repetitions: how often launches repeat operations; None: a repeated operation is recorded as one.
    """

    def __init__(self, tables: Sequence[Tensor | int], kind: Sequence[Hashable] = (), contexts: Sequence[Any] = (),
                 board: Board | None = None, caster: Any = None, target: Target | None = None,
                 repetitions: Repetitions | None = None):
        self.repetitions = repetitions
        self.tables, self.contexts, self.board, self.caster = RecordedInputs(tables), contexts, board, caster
        tensors = [table for table in tables if isinstance(table, Tensor)]
        self.device = tensors[0].device if tensors else torch.device("cpu")
        self.target = target_of(self.device) if target is None else target
        deterministic = torch.are_deterministic_algorithms_enabled()  # by which targets may add numbers otherwise
        self.kind = RECORDINGS.kind(*kind, self.target, deterministic, self.tables.pattern, lying(tensors),
                                    None if repetitions is None else repetitions.most)
        self.kinds: dict[Hashable, int] = {}  # of arguments, by their names

    def rest(self) -> None:
        """Dismisses the helper threads, if there are any."""
        if self.board is not None:
            self.board.close()

    def play(self, key: tuple, step: Step, arguments: tuple, count: int | LaneCount, blank: Callable | None = None,
             name: Hashable = None, counts: Sequence[int | LaneCount] = (), waits: bool = True) -> Played | None:
        """Records a step, or plays its recording, and returns the results; None if it cannot be recorded, only called.

        Args:
            key: hashable; what the step does depends on nothing else but the tape and the structure of the arguments.
            step: to record it, it is called with arguments without contents.
            arguments: records, whose tensors are () or have an entry for each of some lanes.
            count: the number of all lanes; what is done with none is called.
            blank: makes arguments without contents, from these, a `Reserve` and, if there are any, numbers that stand for
                `counts`.
            name: all arguments of one name have one structure, which is looked at once; None: it is looked at each time.
            counts: numbers of lanes that the arguments hold, or where some begin, in ascending order.
            waits: False: numbers of lanes found on a GPU stay there, and results have room for all lanes.
        """
        if not most_of(count):
            self.rest()
            return None
        varying = self.varying(arguments)
        blank = without_contents if blank is None else blank
        in_place = any([isinstance(border, LaneCount) for border in counts])  # see `Recording`
        taped = self.kept((*key, in_place), arguments, varying, name,
                          partial(self.record, step, arguments, blank, len(counts), in_place))
        if taped is None:
            self.rest()
            return None
        if isinstance(taped.recorded, RecordedLaunches):
            results, numbers = taped.recorded(varying, self.tables, count, counts, self.caster, waits, self.contexts)
            if self.repetitions is not None:
                self.repetitions.add([numbers[place] for place in taped.recorded.left])
        else:
            results, numbers = taped.recorded(varying, self.tables, count, self.board, counts, self.contexts)
            if self.caster is not None:
                self.caster.count(sum([numbers[last] - numbers[first] for first, last in taped.recorded.rays]))
        return Played(dual(*results) if taped.dual else results, [numbers[place] for place in taped.counts], taped.constant)

    def link(self, key: tuple, step: Step, arguments: tuple, blank: Callable) -> tuple[Link | None, RecordedInputs]:
        """Records a step whose results are handed to the next one, tile by tile of lanes; None if it cannot be recorded.

        Also returns the inputs of the recording. Args: as for `play`.
        """
        varying = self.varying(arguments)
        link = self.kept(("link", *key), arguments, varying, None, partial(self.record_link, step, arguments, blank))
        return link, RecordedInputs([*varying.items, *self.tables.items])

    @staticmethod
    def varying(arguments: tuple) -> RecordedInputs:
        """The tensors of all arguments, tangents included, in order, as the inputs of a recording."""
        return RecordedInputs([tensor for argument in arguments for tensor in tangents_and_tensors(argument)])

    def kept(self, key: tuple, arguments: tuple, varying: RecordedInputs, name: Hashable, make: Callable[[], Any]) -> Any:
        """The recording that `make` makes, cached for arguments of this structure; None if it cannot be made."""
        if not all(map(Tensor.is_contiguous, varying.items)):
            return None
        kind = self.kinds.get(name)
        if kind is None:
            kind = RECORDINGS.kind(self.kind, *structure_of(arguments))
            if name is not None:
                self.kinds[name] = kind
        return RECORDINGS.of((kind, varying.pattern, *key), make)

    def record(self, step: Step, arguments: tuple, blank: Callable, counts: int, in_place: bool) -> Taped | None:
        """Records a step; `in_place`: its inputs have room for all lanes, and stand at their lanes' places."""
        reserve = Reserve(self.device)
        borders = Recording([]).borders(counts + 1, ALL)[1:-1] if counts else []
        arguments = blank(arguments, reserve, borders) if counts else blank(arguments, reserve)
        try:
            listener, given, played = self.listened(step, arguments, reserve, borders)
            results = values_and_tangents(played.results) if inside_dual_level() else played.results
            listener.in_place = len(given) - len(self.tables.items) if in_place else 0
            counts = tuple([listener.points[count] for count in played.counts])
            return Taped(self.target.recorded(listener, given, results), counts, played.constant, inside_dual_level())
        except NotRecordable:
            return None

    def record_link(self, step: Step, arguments: tuple, blank: Callable) -> Link | None:
        """Records a step whose results the next recorded step reads, for `link`."""
        reserve = Reserve()
        try:
            listener, given, played = self.listened(step, blank(arguments, reserve), reserve)
            recorded = Recorded(listener, given, tangents_and_tensors(played.results))
            return Link(recorded, handed(recorded), values_and_tangents(played.results))
        except NotRecordable:
            return None

    def listened(self, step: Step, arguments: tuple, reserve: Reserve,
                 borders: Sequence[int] = ()) -> tuple[Recording, list[Tensor | int], Played]:
        """Runs a step on arguments without contents: the recording, its inputs, and the step's results."""
        given = [*self.varying(arguments).items, *self.tables.items]
        most = None if self.repetitions is None else self.repetitions.most
        listener = Recording(given, borders, reserve, self.contexts, most)
        with torch.no_grad(), listening(listener):
            return listener, given, step(*arguments)


def without_contents(record: Any, reserve: Reserve, lanes: int = ALL) -> Any:
    """A copy of a record whose tensors have no contents; equal tensors stay equal, numbers are kept."""
    made: dict[tuple[int, torch.dtype], Tensor] = {}  # tensors without entries all have one address

    def like(leaf):
        if not isinstance(leaf, Tensor) or leaf.dim() == 0:
            return leaf
        return made.setdefault((leaf.data_ptr(), leaf.dtype), reserve.tensor(leaf.dtype, lanes))

    return dual(*[with_leaves(part, list(map(like, leaves_of(part)))) for part in values_and_tangents(record)])


def structure_of(record: Any) -> list:
    """The structure of a record, with tangents; equal where one recording serves."""
    structure: list = []
    flatten(values_and_tangents(record) if inside_dual_level() else record, [], structure)
    return structure


def lying(tables: Sequence[Tensor]) -> tuple:
    """The dtypes, dimensions and strides of tables, as far as compiled code depends on them."""
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
