"""What is recorded with lanes does the same again, whatever the numbers of lanes turn out to be."""

import math
from collections.abc import Iterator

import pytest
import torch
from torch import Tensor

from torch_radbp.jit import LaneFunction
from torch_radbp.jit.cpu.board import board
from torch_radbp.jit.cpu.recorded import Recorded
from torch_radbp.jit.order import all_lanes, chosen, duplicated, inverted, nothing, partition, put, repeated
from torch_radbp.jit.recording.addition import Addition, Sums
from torch_radbp.jit.recording.recording import ALL, NotRecordable, Recording, Reserve, listening, outside
from torch_radbp.jit.recording.results import RecordedInputs
from torch_radbp.jit.scatter import scatter_add
from torch_radbp.jit.tape import without_contents
from torch_radbp.threads.team import alone_in_torch

QUEUES = 5
LANES = (1, 3, 17, 1000, 10_001, 70_000)


def recorded(function, *tensors: Tensor, tables: tuple[Tensor | int, ...] = (), contexts: tuple = ()) -> Recorded:
    """A function of lanes like these, recorded."""
    given = [torch.empty(ALL, dtype=tensor.dtype) for tensor in tensors]
    listener = Recording([*given, *tables], contexts=contexts)
    with torch.no_grad(), listening(listener):
        results = function(*given)
    return Recorded(listener, [*given, *tables], results)


def again(made: Recorded, *tensors: Tensor, tables: tuple[Tensor | int, ...] = (), threads: int = 2, contexts: tuple = ()):
    """What was recorded, done for these lanes."""
    with alone_in_torch(threads=threads), board() as own:
        return made(RecordedInputs(tensors), RecordedInputs(tables), len(tensors[0]), own, contexts=contexts)[0]


TWICE = LaneFunction(lambda x, y: (x + y, x - y, y))
SQUARE = LaneFunction(lambda x, table, index: (x * x, torch.index_select(table, 0, index)), ("table",))


def looped(x: Tensor, y: Tensor):
    """Two loops, of which the second reads what the first writes."""
    a, b, _ = TWICE(x, y)
    return TWICE(a, b)


@pytest.mark.parametrize("threads", [1, 2, 4])
@pytest.mark.parametrize("lanes", LANES)
def test_loops_read_what_others_write(lanes, threads):
    made = recorded(looped, torch.empty(1), torch.empty(1))
    x, y = torch.rand(2, lanes).unbind()
    found = again(made, x, y, threads=threads)
    expected = looped(x, y)
    assert expected[0].abs().max() > 0
    assert all(map(torch.equal, found, expected))


def sorted_by(number: Tensor, x: Tensor, targets: Tensor):
    """Lanes queue by queue, each queue through a loop of its own, and those whose number is high."""
    order, counts = partition(number, QUEUES)
    room, first = (x.new_empty(len(x)), x.new_empty(len(x)), x.new_empty(len(x))), 0
    for count in counts:
        if count:
            own = GATHERED(x, order[first:first + count])
            TWICE.into(room, first, own, own)
        first += count
    flags = LARGE(room[0])
    alive = chosen(flags)
    put((targets,), order, (room[0],))
    return order, room, inverted(flags), nothing(flags), alive, GATHERED(room[0], alive)


GATHERED = LaneFunction(lambda table, index: torch.index_select(table, 0, index), ("table",))
LARGE = LaneFunction(lambda x: x > 1.0)


@pytest.mark.parametrize("most", [1, 2, QUEUES])
@pytest.mark.parametrize("lanes", LANES)
def test_queues_and_those_that_go_on_are_counted_each_time(lanes, most):
    made = recorded(sorted_by, torch.empty(1, dtype=torch.int32), torch.empty(1), torch.empty(1))
    generator = torch.Generator().manual_seed(lanes)
    number = torch.randint(most, (lanes,), generator=generator, dtype=torch.int32)  # some queues are empty
    x, mine, own = torch.rand(lanes, generator=generator), torch.zeros(lanes), torch.zeros(lanes)
    found, expected = again(made, number, x, mine), sorted_by(number, x, own)
    for one, other in zip((found[0], *found[1], *found[2:]), (expected[0], *expected[1], *expected[2:])):
        assert one.dtype == other.dtype and torch.equal(one, other)
    assert torch.equal(mine, own) and torch.equal(own, 2 * x)


def test_tables_are_those_of_the_call():
    table, index = torch.arange(7.0), torch.arange(7, dtype=torch.int32).repeat(9)

    def read(x: Tensor, index: Tensor):
        return SQUARE(x, table, index)

    made = recorded(read, torch.empty(1), index, tables=(table,))
    x = torch.rand(63)
    for other in (table, table * 3.0, torch.arange(11.0)):
        assert torch.equal(again(made, x, index, tables=(other,))[1], other[index])


def sums(entries: int) -> tuple[Tensor, Tensor, Sums]:
    total, touched = torch.zeros(entries, 4, dtype=torch.float64), torch.zeros(-(-entries // 16), dtype=torch.bool)
    return total, touched, Sums([total], touched)


@pytest.mark.parametrize("lanes", [0, 5, 3000])
def test_what_is_scattered_goes_to_the_totals_of_the_call(lanes):
    total, touched, own = sums(40)

    def scattered(index: Tensor, x: Tensor, flags: Tensor):
        some = chosen(flags)
        scatter_add([Addition(AS_INDEX(index, some), [GATHERED(x, some)], own)])
        return ()

    tables = total.data_ptr(), touched.data_ptr()
    made = recorded(scattered, torch.empty(1, dtype=torch.int32), torch.empty(1), torch.empty(1, dtype=torch.bool),
                    tables=tables)
    index, x = torch.randint(40, (4000,), dtype=torch.int32), torch.rand(4000)
    flags = torch.arange(4000) < lanes
    mine, mine_touched, _ = sums(40)
    again(made, index, x, flags, tables=(mine.data_ptr(), mine_touched.data_ptr()))
    scattered(index, x, flags)
    assert bool(mine.any()) == (lanes > 0) and torch.equal(mine, total) and torch.equal(mine_touched, touched)


GATHERED = LaneFunction(lambda x, lanes: torch.index_select(x, 0, lanes), ("x",))


def by_queue(number: Tensor, x: Tensor) -> Iterator[Tensor]:
    """The numbers of each queue that has lanes, gathered when they are asked for."""
    order, counts = partition(number, QUEUES)
    first = 0
    for count in counts:
        if count:
            yield GATHERED(x, order[first:first + count])
        first += count


def asking(context, number: Tensor, x: Tensor):
    """Lanes queue by queue, for each of which someone outside is asked, and a loop over what was found."""
    found = []
    for own in by_queue(number, x):
        answers, = outside(lambda context, given: [(context["factor"] * x, x.max() - x) for _, x in given], context,
                           [(own, own)], [2])
        found += [*answers, *TWICE(*answers)]
    return found


@pytest.mark.parametrize("threads", [1, 2, 4])
@pytest.mark.parametrize("lanes", LANES)
def test_what_is_done_outside_is_done_in_the_context_of_the_call(lanes, threads):
    contexts = {"factor": 2.0}, {"factor": 3.0}
    number, x = torch.randint(QUEUES, (lanes,), dtype=torch.int32), torch.rand(lanes)
    made = recorded(lambda number, x: asking(contexts[0], number, x), number, x, contexts=contexts[:1])
    for context in contexts:
        found = again(made, number, x, threads=threads, contexts=(context,))
        expected = asking(context, number, x)
        assert expected[0].abs().max() > 0
        assert all(map(torch.equal, [part for part in found if len(part)], expected))


def asking_together(context, number: Tensor, x: Tensor):
    """As `asking`, all queues in one turn."""
    given = [(own, own) for own in by_queue(number, x)]

    def work(context, given):
        context["turns"] = context.get("turns", 0) + 1
        most = max(float(x.max()) for _, x in given if len(x))
        return [(context["factor"] * x, most - x) for _, x in given]

    answers = outside(work, context, given, [2] * len(given))
    return [part for own in answers for part in (*own, *TWICE(*own))]


@pytest.mark.parametrize("threads", [1, 4])
@pytest.mark.parametrize("lanes", LANES)
def test_queues_ask_outside_in_one_turn_whether_or_not_all_have_lanes(lanes, threads):
    number, x = torch.randint(QUEUES - 1, (lanes,), dtype=torch.int32), torch.rand(lanes)  # the last has none
    context = {"factor": 2.0}
    made = recorded(lambda number, x: asking_together(context, number, x), number, x, contexts=(context,))
    found, turns = again(made, number, x, threads=threads, contexts=(own := {"factor": 3.0},)), own["turns"]
    expected = asking_together({"factor": 3.0}, number, x)
    assert turns == 1 and expected[0].abs().max() > 0
    assert all(map(torch.equal, [part for part in found if len(part)], expected))


def test_what_is_done_outside_with_what_a_call_is_not_told_is_refused():
    with pytest.raises(NotRecordable, match="more than is told"):
        recorded(lambda number, x: asking({"factor": 2.0}, number, x), torch.zeros(1, dtype=torch.int32), torch.zeros(1))


def test_errors_outside_are_raised_and_let_the_helpers_go():
    number, x = torch.zeros(20_000, dtype=torch.int32), torch.rand(20_000)
    context = {"factor": 2.0}
    made = recorded(lambda number, x: asking(context, number, x), number, x, contexts=(context,))
    for _ in range(50):
        with pytest.raises(KeyError, match="factor"):
            again(made, number, x, threads=3, contexts=({},))
    assert torch.equal(again(made, number, x, threads=3, contexts=(context,))[0], 2 * x)


AS_INDEX = LaneFunction(lambda table, index: torch.index_select(table, 0, index), ("table",))


def test_counts_that_the_function_is_told_may_differ():
    def ended(x: Tensor):
        return looped(x[:300], x[:300])

    given = torch.empty(ALL)
    listener = Recording([given], [300])
    with torch.no_grad(), listening(listener):
        made = Recorded(listener, [given], ended(given))
    x = torch.rand(5000)
    for count in (0, 1, 300, 5000):
        with board() as own:
            found, counts = made(RecordedInputs([x]), RecordedInputs([]), len(x), own, [count])
        assert counts[2] == count
        assert all(map(torch.equal, found, looped(x[:count], x[:count]) if count else (x[:0],) * 3))


@pytest.mark.parametrize("function, why", [
    (lambda x: TWICE(x + 1.0, x), "torch.add"),
    (lambda x: TWICE(torch.ones(ALL), x), "neither given nor made"),
    (lambda x: TWICE(x[:12], x[:12]), "neither given|no number"),
    (lambda x: bool(x.any()), "torch.any")])
def test_what_would_be_lost_is_refused(function, why):
    with pytest.raises(NotRecordable, match=why):
        recorded(function, torch.empty(1))


def test_nothing_listens_afterwards():
    with pytest.raises(NotRecordable):
        recorded(lambda x: x + 1.0, torch.empty(1))
    x = torch.rand(5)
    assert torch.equal(TWICE(x, x)[0], 2 * x)


def test_what_is_given_twice_is_told():
    x, y = torch.rand(3), torch.rand(3)
    assert RecordedInputs([x, y, x, 5, 5]).pattern == (0, 1, 0, 3, 3) != RecordedInputs([x, y, x.clone(), 5, 5]).pattern


def test_what_has_no_entries_keeps_its_type():
    given = torch.empty(0), torch.empty(0, dtype=torch.int32)
    blank = without_contents(given, Reserve())
    assert [each.dtype for each in blank] == [torch.float32, torch.int32]


def test_an_error_lets_the_helpers_go():
    for _ in range(50):
        with pytest.raises(KeyError), alone_in_torch(threads=3), board() as own:
            own.open()
            raise KeyError
    made, x = recorded(looped, torch.empty(1), torch.empty(1)), torch.rand(20_000)
    assert torch.equal(again(made, x, x, threads=3)[0], 2 * x)


DOWN = LaneFunction(lambda x, index: torch.index_select(x, 0, index) - 1.0, ("x",))
POSITIVE = LaneFunction(lambda x: x > 0.0)


def counted_down(x: Tensor):
    """Halves numbers until they are below 1, and between that counts down to 0 copies of them; how often in all."""
    x, turns = duplicated(x), duplicated(x)
    lanes = all_lanes(x)

    def halved(lanes: Tensor) -> Tensor:
        inner = duplicated(x)

        def down(lanes: Tensor) -> Tensor:
            lower, more = DOWN(inner, lanes), MORE(turns, lanes)
            put((inner, turns), lanes, (lower, more))
            return GATHERED(lanes, chosen(POSITIVE(lower)))

        repeated(lanes, down)
        half = HALF(x, lanes)
        put((x,), lanes, (half,))
        return GATHERED(lanes, chosen(LARGE(half)))

    repeated(lanes, halved)
    return x, turns


HALF = LaneFunction(lambda x, index: torch.index_select(x, 0, index) * 0.5, ("x",))
MORE = LaneFunction(lambda x, index: torch.index_select(x, 0, index) + 1.0, ("x",))


@pytest.mark.parametrize("most", [0.5, 9.0])
@pytest.mark.parametrize("lanes", LANES)
def test_what_is_repeated_is_done_while_lanes_go_on(lanes, most):
    made = recorded(counted_down, torch.empty(1))
    x = torch.rand(lanes) * most
    found = again(made, x)
    halves, turns = counted_down(x)
    assert all(map(torch.equal, found, (halves, turns)))
    assert bool((halves <= 1.0).all()) and bool((turns > x).all())
    expected = [counted(value) for value in x.tolist()]
    assert (turns - x).round().tolist() == expected


def counted(x: float) -> float:
    """The turns of one number."""
    turns = max(1, math.ceil(x))
    while x > 2.0:
        x /= 2.0
        turns += math.ceil(x)
    return turns


def test_rays_that_are_cast_while_something_is_repeated_are_counted_each_time():
    given = torch.empty(ALL)
    listener = Recording([given])
    with torch.no_grad(), listening(listener):
        x = duplicated(given)

        def cast(lanes: Tensor) -> Tensor:
            lower = DOWN(x, lanes)
            listener.rays.append(listener.span(len(lanes)))
            put((x,), lanes, (lower,))
            return GATHERED(lanes, chosen(POSITIVE(lower)))

        repeated(all_lanes(x), cast)
    made = Recorded(listener, [given], (x,))
    values = torch.tensor([0.5, 3.5, 1.5, 2.0])
    with board() as own:
        _, counts = made(RecordedInputs([values]), RecordedInputs(()), 4, own)
    (first, last), = made.rays
    assert counts[last] - counts[first] == 1 + 4 + 2 + 2


def test_what_is_done_outside_is_not_repeated():
    def asked(x: Tensor):
        def ask(lanes: Tensor) -> Tensor:
            outside(lambda context, given: given, None, [(x,)], [1])
            return lanes

        repeated(all_lanes(x), ask)
        return x

    with pytest.raises(NotRecordable, match="cannot be repeated"):
        recorded(asked, torch.empty(1), contexts=(None,))
