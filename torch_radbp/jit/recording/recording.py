"""Records operations on lanes: loops, their order and memory, for any numbers of lanes.

A function that calls lane functions, casts rays and moves lanes about is called once while a `Recording` listens. Nothing is
computed then: its tensors have no contents, and where it is told how many lanes there are, it is told a number that stands
for the count that will be found. From such numbers the recording reads off what each loop runs over.
"""

from __future__ import annotations

import mmap
import random
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import torch
from torch import Tensor

from torch_radbp.jit.recording.addition import Addition
from torch_radbp.jit.recording.lane_operations import (
    Added,
    Chosen,
    Copy,
    Inverted,
    LaneSpan,
    LoopBody,
    MemoryPlace,
    NewTensor,
    Operation,
    Outside,
    OutsideWork,
    Partition,
    Put,
    RecordedLoop,
    Repeated,
    Scattered,
)
from torch_radbp.tensors.torch_internals import TorchDispatchMode

ALL = 262_147  # stands for all lanes
TRIES = 100_000
CPU = torch.device("cpu")
BLOCK = 1 << 26  # bytes of addresses that are reserved at a time
MAKES = ("empty", "new_empty", "empty_like", "empty_strided", "new_empty_strided")
OF_DUALS = ("is_same_size", "_has_same_storage_numel")  # asked of a tensor and its tangent when a dual tensor is made
HARMLESS = (*MAKES, *OF_DUALS, "slice", "narrow", "detach", "alias", "view", "unbind", "select", "as_strided")


class NotRecordable(Exception):
    """Error: an operation cannot be recorded; the message says why."""


class Reserve:
    """Addresses for tensors without contents; on the CPU they take no memory, as nothing is written there."""

    def __init__(self, device: torch.device = CPU) -> None:
        self.device, self.left, self.made = device, memoryview(b""), []

    def tensor(self, dtype: torch.dtype, entries: int) -> Tensor:
        """A tensor (entries,) without contents, at an address of its own."""
        if not entries:
            return torch.empty(0, dtype=dtype, device=self.device)
        if self.device.type != "cpu":
            self.made.append(torch.empty(entries, dtype=dtype, device=self.device))
            return self.made[-1]
        size = -(-entries * dtype.itemsize // 64) * 64
        if size > len(self.left):
            self.left = memoryview(mmap.mmap(-1, max(BLOCK, size)))
        part, self.left = self.left[:size], self.left[size:]
        return torch.frombuffer(part, dtype=dtype, count=entries)


class Recording:
    """Listens to operations on lanes, and records them.

    Args:
        given: the inputs of the recorded function, tensors of lanes without contents, and addresses of what else loops read.
        counts: numbers, as `borders` draws them, that stand for numbers of lanes among the inputs, in ascending order;
            `ALL`, for all lanes, is always known.
        reserve: where tensors without contents come from.
        contexts: of work outside of machine code, see `outside`.
        most: how often to unroll repeated operations, see `Repetitions`; None: they become one operation, `Repeated`.
    """

    def __init__(self, given: Sequence[Tensor | int], counts: Sequence[int] = (), reserve: Reserve | None = None,
                 contexts: Sequence[Any] = (), most: int | None = None):
        self.reserve, self.contexts, self.most = reserve or Reserve(), contexts, most
        # So many tensors that are given, the first, stand where their lanes do, in room for all, if these are a part of all.
        self.in_place = 0
        self.left: list[int] = []  # indices of the counts of lanes that go on after the last repetition
        self.given: dict[int, int] = {}  # numbers of what is given, by address
        for number, item in enumerate(given):
            self.given.setdefault(address_of(item), number)
        self.operations: list[Operation] = []
        self.rays: list[LaneSpan] = []  # that are cast
        self.made: list[NewTensor] = []
        self.memory: dict[int, int] = {}  # numbers of tensors that were made, by address
        self.alive: list = [given]  # so that addresses remain theirs
        self.repeating = False
        self.given_counts, self.counts = len(counts), 2 + len(counts)
        self.points = {0: 0, ALL: 1}  # numbers of counts by what stands for them
        self.spans = {0: LaneSpan(0, 0), ALL: LaneSpan(0, 1)}
        self.drawn = random.Random(0)
        self.know([0, *counts], [0, *range(2, self.counts)])

    # -- Where things lie -----------------------------------------------------------------------------------------------

    def span(self, lanes: int) -> LaneSpan:
        """The span of lanes for which a number of lanes stands in this recording."""
        if lanes not in self.spans:
            raise NotRecordable(f"{lanes} lanes are no number that was found")
        return self.spans[lanes]

    def place(self, item: Tensor | int) -> MemoryPlace:
        """The memory place of a tensor, or of an address."""
        known = self.given.get(address_of(item))
        if known is not None:
            return MemoryPlace(False, known, size=item.element_size() if isinstance(item, Tensor) else 8)
        if not isinstance(item, Tensor):
            raise NotRecordable("a loop reads what is not given")
        return self.place_made(item)

    def place_made(self, tensor: Tensor) -> MemoryPlace:
        """The memory place of a tensor made while recording, or of a part of a given one."""
        start, offset = tensor.untyped_storage().data_ptr(), tensor.storage_offset()
        number = self.memory.get(start, self.given.get(start))
        if number is None or offset not in self.points or not tensor.is_contiguous():
            raise NotRecordable(f"a tensor {tuple(tensor.shape)} is neither given nor made by a loop")
        return MemoryPlace(start in self.memory, number, self.points[offset], tensor.element_size())

    def written(self, tensor: Tensor, first: int = 0) -> MemoryPlace:
        """The memory place of a tensor that is written, from an entry on; an unknown tensor counts as made now."""
        address = tensor.untyped_storage().data_ptr()
        if tensor.data_ptr() not in self.given and address not in self.memory:
            self.memory[address] = len(self.made)
            self.made.append(NewTensor(tensor.dtype, self.span(tensor.numel())))
            self.alive.append(tensor)
        place = self.place(tensor)
        if first not in self.points or (first and place.first):
            raise NotRecordable(f"entry {first} is no number that was found")
        return place._replace(first=self.points[first] or place.first)

    # -- What is done ---------------------------------------------------------------------------------------------------

    def loop(self, body: int | LoopBody, lanes: int, part: int, inputs: Sequence[Tensor | int], outputs: Sequence[Tensor],
             first: int = 0, lengths: bool = False, of_lanes: Sequence[bool] = ()) -> None:
        """Records a compiled loop over lanes.

        Args:
            body, lanes, part: as of `team.run_lanes`.
            inputs: tensors, or addresses of what lies at the same place in every call.
            outputs: written into from the entry `first` on.
            lengths: whether the lengths of the inputs are read, too.
            of_lanes: whether each input has an entry for each lane of the loop; (): not needed.
        """
        places = tuple(map(self.place, inputs))
        spans = tuple(self.span(item.numel()) if place.made else LaneSpan(0, 0) for item, place in zip(inputs, places))
        self.operations.append(RecordedLoop(body, self.span(lanes), part, places, spans if lengths else None,
                                            tuple(self.written(output, first) for output in outputs), tuple(of_lanes)))

    def cast(self, *loop) -> None:
        """Records a compiled loop that casts a ray for each lane, so that rays are counted; args as of `loop`."""
        self.loop(*loop)
        self.rays.append(self.operations[-1].lanes)

    def partition(self, number: Tensor, queues: int) -> tuple[Tensor, list[int]]:
        """Records a sorting of lanes into queues; returns their order, and numbers that stand for the queues' lengths."""
        lanes = self.span(number.numel())
        if number.element_size() != 4 or lanes.first != 0:
            raise NotRecordable("lanes are partitioned by int32")
        order = number.new_empty(number.numel(), dtype=torch.int32)
        borders = self.borders(queues, number.numel())
        self.operations.append(Partition(self.place(number), lanes, queues, self.written(order), self.counts))
        numbers = [0, *range(self.counts, self.counts + queues - 1), lanes.last]
        self.counts += queues - 1
        self.know(borders, numbers)
        return order, [last - first for first, last in zip(borders, borders[1:])]

    def know(self, borders: Sequence[int], numbers: Sequence[int]) -> None:
        """Registers numbers that stand for counts, in ascending order, and for the lanes between them."""
        for place, border in enumerate(borders):
            self.points[border] = numbers[place]
            for before in range(place):
                self.spans[border - borders[before]] = LaneSpan(numbers[before], numbers[place])

    def borders(self, queues: int, lanes: int, least: int = 1) -> list[int]:
        """Draws numbers that stand for the starts of queues and the end of the last; all differences are distinct. None is
        less than `least`."""
        borders, known = [0, lanes], set(self.spans)
        for _ in range(TRIES):
            if len(borders) == queues + 1:
                return sorted(borders)
            border = self.drawn.randrange(least, lanes)
            found = {abs(border - other) for other in borders}
            if len(found) == len(borders) and known.isdisjoint(found):
                borders.append(border)
                known |= found
        raise NotRecordable(f"{queues} queues are too many")

    def chosen(self, flags: Tensor) -> Tensor:
        """Records the selection of lanes by flags; the result's length stands for their number."""
        order = flags.new_empty(flags.numel(), dtype=torch.int32)
        if not len(order):
            return order
        # Nearly as large, so that there are numbers left for lanes that are chosen of these.
        _, count, _ = self.borders(2, flags.numel(), max(1, flags.numel() - flags.numel() // 8 - 1))
        self.operations.append(Chosen(self.place(flags), self.span(flags.numel()), self.written(order), self.counts))
        self.points[count], self.spans[count] = self.counts, LaneSpan(0, self.counts)
        self.counts += 1
        return order[:count]

    def all_lanes(self, like: Tensor) -> Tensor:
        """Records the list of all lanes of a tensor, (N,) int32."""
        lanes = self.chosen(self.inverted(self.nothing(self.reserve.tensor(torch.bool, like.numel()))))
        return lanes if not len(like) else lanes.as_strided((len(like),), (1,))

    def repeated(self, lanes: Tensor, function: Callable[[Tensor], Tensor]) -> None:
        """Records a function that is repeated until no lane goes on; it is called once, for lanes of any repetition, or,
        unrolled, `most` times."""
        if not len(lanes):
            return
        if self.most is not None:
            for _ in range(self.most):
                lanes = function(lanes)
            self.left.append(self.span(len(lanes)).last)
            return
        _, number, _ = self.borders(2, lanes.numel())
        count, self.counts = self.counts, self.counts + 1
        self.points[number], self.spans[number] = count, LaneSpan(0, count)
        each = self.reserve.tensor(lanes.dtype, number)
        self.copy(each, lanes, 0)
        before = self.operations, self.rays, self.repeating
        self.operations, self.rays, self.repeating = [], [], True
        rest = function(each)
        operations, rays = self.operations, self.rays
        self.operations, self.rays, self.repeating = before
        self.operations.append(Repeated(self.place(each), self.span(lanes.numel()), count, tuple(operations),
                                        self.place(rest), self.span(rest.numel()), tuple(rays), self.counts))
        self.rays.append(LaneSpan(0, self.counts))
        self.counts += 1

    def duplicated(self, tensor: Tensor) -> Tensor:
        """Records a copy of a tensor of lanes, and returns it."""
        result = self.reserve.tensor(tensor.dtype, tensor.numel())
        if len(result):
            self.copy(result, tensor, 0)
        return result

    def put(self, targets: Sequence[Tensor], place: Tensor, entries: Sequence[Tensor]) -> None:
        """Records a scatter of entries into tensors, as `order.put` does it."""
        for size in {target.element_size() for target in targets}:
            pairs = tuple((self.place(entry), self.written(target)) for target, entry in zip(targets, entries)
                          if target.element_size() == size)
            self.operations.append(Put(self.place(place), self.span(place.numel()), pairs))

    def inverted(self, flags: Tensor) -> Tensor:
        """Records the negation of flags, and returns it."""
        return self.flags_like(flags, self.place(flags) if len(flags) else None)

    def nothing(self, flags: Tensor) -> Tensor:
        """Records flags that are all false, and returns them."""
        return self.flags_like(flags, None)

    def flags_like(self, like: Tensor, inverted: MemoryPlace | None) -> Tensor:
        """Records flags of as many lanes as `like`: the negation of those at `inverted`, or all false."""
        result = torch.empty_like(like)
        if len(result):
            self.operations.append(Inverted(inverted, self.span(like.numel()), self.written(result)))
        return result

    def scatter_add(self, groups: Sequence[Sequence[Addition]], lanes: int,
                    loops: Mapping[tuple[torch.dtype, int], Any]) -> None:
        """Records a scatter-add of lanes' numbers to tables.

        Args:
            groups: of additions; groups may run side by side.
            lanes: of all.
            loops: the target's functions, by dtype and number of tables.
        """
        def added(addition: Addition) -> Added:
            index, numbers, sums = addition
            places = [tuple(map(self.place, part)) for part in (numbers, sums.addresses)]
            return Added(loops[numbers[0].dtype, len(numbers)], self.place(index), self.place(sums.words[0]),
                         *sums.words[1:], *places)

        self.operations.append(Scattered(tuple(tuple(map(added, group)) for group in groups), self.span(lanes)))

    def outside(self, work: Callable, context: Any, given: Sequence[Sequence[Tensor]],
                results: Sequence[int]) -> list[list[Tensor]]:
        """Records work outside of machine code, such as a neural network; args as of the function `outside`."""
        if self.repeating:
            raise NotRecordable("what is done outside cannot be repeated")
        known = [number for number, own in enumerate(self.contexts) if own is context]
        if not known:
            raise NotRecordable("what is done outside depends on more than is told")
        found = [[part[-1].new_empty(part[0].numel()) for _ in range(count)] for part, count in zip(given, results)]
        self.operations.append(Outside(work, known[0], tuple(
            OutsideWork(self.span(part[0].numel()), tuple(map(self.place, part)), tuple(map(self.written, own)))
            for part, own in zip(given, found))))
        return found

    def copy(self, target: Tensor, source: Tensor, first: int) -> None:
        """Records a copy of a tensor's entries to another tensor, from `first` on."""
        self.operations.append(Copy(self.place(source), self.written(target, first), self.span(source.numel())))


def address_of(item: Tensor | int) -> int:
    """The address of a tensor; an address stays as it is."""
    return item.data_ptr() if isinstance(item, Tensor) else item


class Guard(TorchDispatchMode):
    """Stops torch's operations that would read tensors without contents."""

    def __init__(self, recording: Recording):
        super().__init__()
        self.recording = recording

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        name = func.overloadpacket.__name__
        if name not in HARMLESS and any(map(self.has_no_contents, args)):
            raise NotRecordable(f"torch.{name} is called")
        if name in MAKES:
            shape = func(*args, **{**(kwargs or {}), "device": "meta"})
            if shape.dim() == 1 and shape.numel() > 1 and shape.numel() in self.recording.spans:
                return self.recording.reserve.tensor(shape.dtype, shape.numel())
        return func(*args, **(kwargs or {}))

    @classmethod
    def _should_skip_dynamo(cls) -> bool:
        """False: torch must not import its compiler for this mode."""
        return False

    def has_no_contents(self, item) -> bool:
        """True for a tensor without contents, or a list that contains one."""
        if isinstance(item, (list, tuple)):
            return any(map(self.has_no_contents, item))
        return isinstance(item, Tensor) and item.device.type != "meta" and item.numel() > 1 and (
            item.numel() in self.recording.spans)


class _ThreadState(threading.local):
    """Thread-local state: the recording that listens."""

    recording: Recording | None = None
    guard: Guard | None = None


HERE = _ThreadState()


def recording() -> Recording | None:
    """The recording that listens to this thread; None: none does."""
    return HERE.recording


def outside(work: Callable, context: Any, given: Sequence[Sequence[Tensor]],
            results: Sequence[int]) -> Sequence[Sequence[Tensor]]:
    """Runs `work(context, given)`, which no function of lanes can do, such as a neural network.

    A recording calls it again each time it is played, if there are lanes, with a context given then. Where only a device
    knows the number of lanes, N is the most that it may be, and surplus lanes are marked by -1.

    Args:
        work: depends on nothing but what it is given.
        given: for each of some queues of lanes, (N,) each; N may be 0 for some. The first is int32, -1 in lanes to skip.
        results: how many tensors are returned for each queue, (N,), of the dtype of the last one given.
    """
    listener = recording()
    return work(context, given) if listener is None else listener.outside(work, context, given, results)


@contextmanager
def listening(recording: Recording) -> Iterator[None]:
    """A context in which this thread's operations on lanes are recorded instead of executed."""
    HERE.recording, HERE.guard = recording, Guard(recording)
    try:
        with HERE.guard:
            yield
    finally:
        HERE.recording = HERE.guard = None


@contextmanager
def unguarded() -> Iterator[None]:
    """A context in which a recording does not check torch's operations on tensors without contents, as for tracing.

    No other mode of torch's may have been entered since the recording began.
    """
    guard = HERE.guard
    if guard is None:
        yield
        return
    guard.__exit__(None, None, None)
    try:
        yield
    finally:
        guard.__enter__()
