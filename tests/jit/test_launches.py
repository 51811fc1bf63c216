"""What is recorded for a GPU does the same as the processor, in one sequence of launches, and waits for no count."""

from functools import partial
from importlib import import_module

import pytest
import torch
from torch import Tensor

from tests.jit.emulated import Emulated
from tests.jit.interpreter import interpreted, needs_interpreter
from torch_radbp.jit import LaneFunction
from torch_radbp.jit.nvidia.gpu import Gpu
from torch_radbp.jit.order import chosen, inverted, nothing, partition, put
from torch_radbp.jit.recording.addition import Addition, Sums
from torch_radbp.jit.recording.lane_count import LaneCount, waited_for
from torch_radbp.jit.recording.recording import outside
from torch_radbp.jit.scatter import scatter_add
from torch_radbp.jit.tape import Played, Tape

QUEUES = 5
LANES = (1, 31, 33, 1000, 10_001)


@pytest.fixture(params=["emulated", pytest.param("interpreted", marks=needs_interpreter)])
def gpu(request, monkeypatch) -> Gpu:
    """A GPU in name, which everything runs on; its tensors lie on the processor."""
    monkeypatch.setenv("RADBP_KERNEL_CACHE", "off")
    gpu = Gpu(Emulated() if request.param == "emulated" else interpreted().launcher)
    run_on(gpu, monkeypatch)
    return gpu


def run_on(gpu: Gpu, monkeypatch: pytest.MonkeyPatch) -> None:
    """What tensors on the processor are moved by."""
    for module in ("order", "scatter", "tape"):
        monkeypatch.setattr(import_module(f"torch_radbp.jit.{module}"), "target_of", lambda device: gpu)


def twice(x: Tensor, y: Tensor):
    return x + y, x - y, y


def gathered(table: Tensor, index: Tensor) -> Tensor:
    return torch.index_select(table, 0, index)


def large(x: Tensor) -> Tensor:
    return x > 1.0


class Functions:
    """The functions of lanes of a step."""

    def __init__(self, target: Gpu | None = None):
        self.twice, self.large = LaneFunction(twice, target=target), LaneFunction(large, target=target)
        self.gathered = LaneFunction(gathered, ("table",), target)


def sorted_by(of: Functions, number: Tensor, x: Tensor, targets: Tensor) -> Played:
    """Lanes queue by queue, each queue through a loop of its own, and those whose number is high."""
    order, counts = partition(number, QUEUES)
    room, first, borders = (x.new_empty(len(x)), x.new_empty(len(x)), x.new_empty(len(x))), 0, []
    for count in counts:
        if count:
            own = of.gathered(x, order[first:first + count])
            of.twice.into(room, first, own, own)
        first += count
        borders.append(first)
    flags = of.large(room[0])
    alive = chosen(flags)
    put((targets,), order, (room[0],))
    found = order, room, inverted(flags), nothing(flags), alive, of.gathered(room[0], alive)
    return Played(found, [*borders, len(alive)])


def numbers(lanes: int, most: int = QUEUES) -> tuple[Tensor, Tensor]:
    generator = torch.Generator().manual_seed(lanes)
    return torch.randint(most, (lanes,), generator=generator, dtype=torch.int32), torch.rand(lanes, generator=generator)


def flat(results) -> list[Tensor]:
    return [results[0], *results[1], *results[2:]]


@pytest.mark.parametrize("most", [1, QUEUES])  # of one queue the others are empty
@pytest.mark.parametrize("lanes", LANES)
def test_queues_are_found_without_waiting_for_their_counts(lanes, most, gpu, monkeypatch):
    (number, x), mine, other = numbers(lanes, most), torch.zeros(lanes), torch.zeros(lanes)
    of = Functions(gpu)
    played = Tape(()).play(("sorted",), lambda *given: sorted_by(of, *given), (number, x, mine), lanes, waits=False)
    monkeypatch.undo()
    expected = sorted_by(Functions(), number, x, other)
    assert all(isinstance(count, LaneCount) for count in played.counts)
    assert [waited_for(count) for count in played.counts] == list(expected.counts)
    for found, wanted in zip(flat(played.results), flat(expected.results)):
        assert len(found) == lanes and torch.equal(found[:len(wanted)], wanted)
    assert torch.equal(mine, other) and other.all()


def test_results_are_as_long_as_the_counts_say_where_the_host_waits_for_these(gpu, monkeypatch):
    number, x = numbers(1000)
    of = Functions(gpu)
    played = Tape(()).play(("sorted",), lambda *given: sorted_by(of, *given), (number, x, torch.zeros(1000)), 1000)
    monkeypatch.undo()
    expected = sorted_by(Functions(), number, x, torch.zeros(1000))
    assert list(played.counts) == list(expected.counts) and 0 < played.counts[-1] < 1000
    assert all(map(torch.equal, flat(played.results), flat(expected.results)))


def test_a_step_goes_on_with_as_many_lanes_as_the_device_knows(gpu):
    """Those of the last step, or of a part of them; beyond these nothing is touched."""
    x, of = torch.arange(100.0) / 50, Functions(gpu)
    first = Tape(()).play(("chosen",), lambda x: Played(alive := chosen(of.large(x)), [len(alive)]), (x,), 100, waits=False)
    room, count = torch.full((100,), -1.0), first.counts[0]

    def step(alive: Tensor, room: Tensor) -> Played:
        put((room,), alive, (of.gathered(x, alive),))
        return Played(())

    Tape((x,)).play(("put",), step, (first.results, room), count, waits=False)
    assert waited_for(count) == 49
    assert torch.equal(room, torch.where(x > 1, x, -1.0))


def test_what_is_done_with_no_lanes_is_called(gpu):
    """As where all paths have ended, and the host knows it."""
    number, x = numbers(0)
    assert Tape(()).play(("sorted",), partial(sorted_by, Functions(gpu)), (number, x, torch.zeros(0)), 0) is None


@pytest.mark.parametrize("backwards", [False, True])
def test_numbers_of_chosen_lanes_are_added_to_totals(backwards, monkeypatch):
    gpu, (number, x) = Gpu(Emulated(backwards=backwards)), numbers(3000)
    run_on(gpu, monkeypatch)
    of, total, touched = Functions(gpu), torch.zeros(8, 64, dtype=torch.float64), torch.zeros(1, dtype=torch.bool)
    sums = Sums([total], touched)

    def step(number: Tensor, x: Tensor) -> Played:
        some = chosen(of.large(of.twice(x, x)[0]))
        scatter_add([Addition(of.gathered(number, some), [of.gathered(x, some)], sums)])
        return Played(())

    assert Tape((total.data_ptr(), touched.data_ptr())).play(("added",), step, (number, x), 3000) is not None
    high = x > 0.5
    expected = torch.zeros(8, dtype=torch.float64).index_add_(0, number[high], x[high].double())
    torch.testing.assert_close(total.sum(1), expected, rtol=1e-13, atol=0.0)
    assert touched.all() and expected[:QUEUES].all()


def replays(gpu: Gpu) -> int:
    """The sequences that were started as graphs so far."""
    return getattr(gpu.launcher, "driver", gpu.launcher).replays


def test_launches_that_come_again_are_started_as_one_graph(gpu, monkeypatch):
    """By what lies in their memory then; and as launches as soon as any of it lies elsewhere."""
    (number, x), targets, of, found = numbers(1000), torch.zeros(1000), Functions(gpu), []

    def play() -> list[Tensor]:
        played = Tape(()).play(("sorted",), lambda *given: sorted_by(of, *given), (number, x, targets), 1000, waits=False)
        return [each.clone() for each in flat(played.results)]

    for turn in range(4):
        number.copy_((number + 1) % QUEUES)
        x.copy_(x.flip(0))
        targets.zero_()
        found.append((number.clone(), x.clone(), targets, play(), targets.clone()))
        assert replays(gpu) == max(0, turn)
    held = [Tape(()).play(("sorted",), lambda *given: sorted_by(of, *given), (number, x, targets), 1000, waits=False)
            for _ in range(2)]
    assert replays(gpu) == 4 and held  # the second one lies elsewhere
    targets = torch.zeros(1000)
    play()
    assert replays(gpu) == 4
    monkeypatch.undo()
    for number, x, _, results, mine in found:
        other = torch.zeros(1000)
        expected = sorted_by(Functions(), number, x, other)
        assert torch.equal(mine, other)
        for each, wanted in zip(results, flat(expected.results)):
            assert torch.equal(each[:len(wanted)], wanted)


def test_a_caller_who_captures_launches_gets_launches(gpu, monkeypatch):
    """Such as `torch.cuda.graph`: a graph inside of a graph is not what it asked for."""
    (number, x), of = numbers(100), Functions(gpu)
    monkeypatch.setattr(gpu.launcher, "is_captured", lambda: True)
    targets = torch.zeros(100)
    for _ in range(3):
        Tape(()).play(("sorted",), lambda *given: sorted_by(of, *given), (number, x, targets), 100, waits=False)
    assert replays(gpu) == 0


def test_what_is_done_outside_is_done_between_launches(gpu):
    of, tape = Functions(gpu), Tape((), contexts=(None,))

    def step(x: Tensor) -> Played:
        (found,), = outside(lambda context, given: [[part[0] + 1.0] for part in given], None, [[of.twice(x, x)[0]]], [1])
        return Played(of.twice(found, found)[0])

    for _ in range(2):  # recorded, and replayed
        x = torch.rand(50)
        assert torch.equal(tape.play(("outside",), step, (x,), 50).results, 2.0 * (2.0 * x + 1.0))
