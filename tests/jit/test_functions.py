"""What a function of lanes may be, how it is called, and the errors of what it may not be."""

import threading
from typing import NamedTuple

import pytest
import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode

from tests.jit.emulated import emulated
from tests.jit.programs import Point, arguments, assert_close, mixed
from torch_radbp.jit import LaneFunction, UnknownOperation
from torch_radbp.jit.cpu.cpu import Cpu

LANES = (0, 1, 15, 16, 17, 100_003)


class Allocations(TorchDispatchMode):
    """Notes the shapes of tensors that are made, views left out."""

    def __enter__(self):
        self.shapes = []
        return super().__enter__()

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        result = func(*args, **(kwargs or {}))
        if isinstance(result, Tensor) and not func.is_view:
            self.shapes.append(tuple(result.shape))
        return result


@pytest.mark.parametrize("lanes", LANES)
@pytest.mark.parametrize("target", [*map(Cpu, (1, 4, 8, 16)), emulated()], ids=["1", "4", "8", "16", "gpu"])
@pytest.mark.parametrize("dtype, rtol", [(torch.float32, 3e-6), (torch.float64, 1e-13)], ids=str)
def test_any_width_and_number_of_lanes(lanes, target, dtype, rtol):
    given = arguments(lanes, dtype)
    assert_close(LaneFunction(mixed, tables=("colours",), target=target)(*given), mixed(*given), rtol)


def test_results_are_the_same_bits_for_any_width_that_fuses_the_same():
    given = arguments(1003)
    results = [LaneFunction(mixed, tables=("colours",), target=Cpu(width))(*given) for width in (1, 4, 8, 16)]
    for other in results[1:]:
        assert torch.equal(other[0].x, results[0][0].x) and torch.equal(other[2], results[0][2])


def test_results_are_the_same_bits_for_any_number_of_threads():
    given, before = arguments(100_003), torch.get_num_threads()
    function = LaneFunction(mixed, tables=("colours",))
    try:
        results = []
        for threads in (1, 2, 3):
            torch.set_num_threads(threads)
            results.append(function(*given)[0].x)
    finally:
        torch.set_num_threads(before)
    assert torch.equal(results[0], results[1]) and torch.equal(results[0], results[2])


def test_one_structure_is_compiled_once_and_another_anew():
    function = LaneFunction(mixed, tables=("colours",))
    for lanes in (5, 100, 3000):
        function(*arguments(lanes))
    point, colours, index, scale, power = arguments(50)
    function(point, (torch.rand(99),), index, scale, power)  # tables of any length
    assert len(function.compiled) == 1
    function(point, colours, index, scale, 2)
    function(*arguments(5, torch.float64))
    assert len(function.compiled) == 3


def test_arguments_that_are_returned_are_not_copied():
    given = arguments(100)
    assert LaneFunction(mixed, tables=("colours",))(*given)[1][2] is given[2]


def test_what_returns_its_arguments_alone_is_not_compiled(monkeypatch):
    for method in ("text", "loop"):
        monkeypatch.setattr(Cpu, method, lambda *arguments: pytest.fail("compiled"))
    x, y = torch.rand(20), torch.rand(20)
    for target in (None, Cpu()):
        function = LaneFunction(lambda x, y: (y, [x]), target=target)
        found = function(x, y)
        assert found[0] is y and found[1][0] is x
        room = torch.zeros(25), [torch.zeros(25)]
        function.into(room, 5, x, y)
        assert torch.equal(room[0][5:], y) and torch.equal(room[1][0][5:], x) and not room[0][:5].any()


def test_a_tensor_that_is_given_twice_is_read_once():
    function = LaneFunction(lambda a, b: a * 2 + b * 2)
    x, y = torch.rand(2, 40).unbind(0)
    assert torch.equal(function(x, x), x * 2 + x * 2) and torch.equal(function(x, y), x * 2 + y * 2)
    assert [len(compiled.inputs) for compiled in function.compiled.values()] == [1, 2]


def test_lanes_that_share_their_memory_are_told_apart():
    function = LaneFunction(lambda a, b: a - 2 * b)
    x, y = torch.rand(2, 40).unbind(0)
    assert torch.equal(function(x, y), x - 2 * y) and torch.equal(function(x, x.view(40)), x - 2 * x)
    assert len(function.compiled) == 1


def test_parts_and_expanded_tensors_are_lanes_too():
    function = LaneFunction(lambda a, b: a - 2 * b)
    a, b = torch.rand(80)[::2], torch.rand(1).expand(40)
    torch.testing.assert_close(function(a, b), a - 2 * b)


def test_constants_of_the_function_and_numbers_are_spread_over_the_lanes():
    found = LaneFunction(lambda x, n: (torch.full_like(x, 0.25), n.expand(x.shape), torch.tensor(3.0) + 0 * x))(
        torch.rand(20), torch.tensor(5))
    assert [tensor.unique().tolist() for tensor in found] == [[0.25], [5], [3.0]]
    assert all(tensor.shape == (20,) for tensor in found)


def test_calls_from_several_threads_run_side_by_side():
    given, function, results = arguments(20_000), LaneFunction(mixed, tables=("colours",)), [None] * 6

    def call(k):
        results[k] = [function(*given)[2] for _ in range(20)][-1]

    threads = [threading.Thread(target=call, args=(k,)) for k in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(function.compiled) == 1
    assert all(torch.equal(result, results[0]) for result in results)


REFUSED = {
    "a sum over lanes": (lambda x: x + x.sum(), "sum"),
    "a sort": (lambda x: x.sort()[0], "sort"),
    "a matrix": (lambda x: torch.stack([x, x]).mean(0), "stack|cat|mean"),
    "reading of lanes": (lambda x: x.index_select(0, x.to(torch.int32)), "not declared a table"),
    "a decision in Python": (lambda x: x if bool((x > 0).all()) else -x, "all|item"),
    "a table of the function's own": (lambda x: x + torch.rand(3)[x.to(torch.int64)], "rand|no argument|table"),
}


@pytest.mark.parametrize("function, words", REFUSED.values(), ids=REFUSED)
def test_what_is_not_of_lanes_is_refused_by_name_and_line(function, words):
    with pytest.raises(UnknownOperation, match=f"({words}).*test_functions.py"):
        LaneFunction(function)(torch.rand(10))


def test_tables_have_no_length_and_are_no_lanes():
    for function, words in ((lambda x, table: x * len(table), "length of a table"),
                            (lambda x, table: x * table.shape[0], "length of a table"),
                            (lambda x, table: x + table, "a table, which can only be read")):
        with pytest.raises(UnknownOperation, match=words):
            LaneFunction(function, tables=("table",))(torch.rand(10), torch.rand(10))


def test_what_was_refused_is_not_traced_again():
    calls = []

    def function(x):
        calls.append(len(x))
        return x.sort()[0]

    fused = LaneFunction(function)
    for _ in range(3):
        with pytest.raises(UnknownOperation, match="sort"):
            fused(torch.rand(4))
    assert len(calls) == 1


def test_an_operation_that_was_refused_leaves_no_trace():
    with pytest.raises(UnknownOperation):
        LaneFunction(lambda x: x.sort()[0])(torch.rand(4))
    assert torch.equal(torch.arange(3).sort()[0], torch.arange(3))


def test_calls_that_make_no_sense_are_errors():
    function = LaneFunction(lambda a, b: a + b)
    with pytest.raises(ValueError, match="3 and of 4 lanes"):
        function(torch.rand(3), torch.rand(4))
    with pytest.raises(ValueError, match=r"\(\) and \(N,\), got \(2, 2\)"):
        function(torch.rand(2, 2), torch.rand(2))
    with pytest.raises(ValueError, match="no tensor with an entry per lane"):
        function(torch.tensor(1.0), torch.tensor(2.0))
    with pytest.raises(ValueError, match="all on the CPU or all on one GPU, got one on meta"):
        function(torch.rand(3, device="meta"), torch.rand(3))
    with pytest.raises(TypeError, match="takes 2 arguments by position, got 1"):
        function(torch.rand(3))
    with pytest.raises(RuntimeError, match="records no derivative"):
        function(torch.rand(3, requires_grad=True), torch.rand(3))
    with torch.no_grad():
        function(torch.rand(3, requires_grad=True), torch.rand(3))
    with pytest.raises(ValueError, match="has no parameters"):
        LaneFunction(lambda a: a, tables=("b",))


@pytest.mark.parametrize("lanes", LANES)
def test_several_calls_fill_parts_of_one_buffer(lanes):
    """Outputs that are the same value, a constant, an argument as it is, of several dtypes, not aligned."""
    def function(x, index):
        return Point(x * 2, None), [x * 2, index, torch.full_like(x, 0.5)], index > 3, x

    fused, first = LaneFunction(function), 7
    x, index = torch.randn(lanes + 20), torch.randint(7, (lanes + 20,), dtype=torch.int32)
    buffers = [torch.full((lanes + 20,), 9, dtype=dtype)
               for dtype in (torch.float32, torch.float32, torch.int32, torch.float32, torch.bool, torch.float32)]
    p, a, b, c, d, e = buffers
    given = (Point(p, None), [a, b, c], d, e)
    for begin, end in ((first, first + lanes), (first + lanes, lanes + 20), (0, first)):
        assert fused.into(given, begin, x[begin:end], index[begin:end]) is given
    (p, _), others, *rest = function(x, index)
    assert all(torch.equal(found, expected) for found, expected in zip(buffers, [p, *others, *rest]))
    assert len(fused.compiled) == 1


def test_a_part_that_is_written_leaves_its_neighbours_alone():
    fused = LaneFunction(lambda x: x + 1)
    for lanes in (1, 3, 15, 16, 17, 33):
        buffer = torch.zeros(60)
        fused.into(buffer, 5, torch.ones(lanes))
        assert torch.equal(buffer.nonzero().squeeze(1), torch.arange(5, 5 + lanes))


def test_contiguous_parts_are_read_where_they_lie():
    fused, x = LaneFunction(lambda x: x * 3), torch.arange(40.0)
    fused(x)
    for lanes in (3, 20):
        with Allocations() as made:
            fused(x[5:5 + lanes])
        assert made.shapes == [(lanes,)]


def test_results_that_do_not_fit_are_errors():
    fused, x = LaneFunction(lambda x: (x, [x + 1])), torch.rand(20)
    with pytest.raises(ValueError, match="returns float32 of 1 dimensions where .* float64 of 1"):
        fused.into((torch.empty(20), [torch.empty(20, dtype=torch.float64)]), 0, x)
    with pytest.raises(ValueError, match="returns tuple of 2 where it is to write into tuple of 1"):
        fused.into((torch.empty(20),), 0, x)
    message = "contiguous tensors of at least 20 entries on cpu, got one of 20 with stride 2"
    with pytest.raises(ValueError, match=message):
        fused.into((torch.empty(20), [torch.empty(40)[::2]]), 0, x)
    beside = torch.frombuffer(bytearray(81), dtype=torch.float32, offset=1)
    with pytest.raises(ValueError, match="aligned, contiguous tensors .*got one of 20 with stride 1 on cpu at 0x"):
        fused.into((torch.empty(20), [beside]), 0, x)
    with pytest.raises(ValueError, match="tensors of at least 23 entries on cpu, got one of 22"):
        fused.into((torch.empty(23), [torch.empty(22)]), 3, x)


def test_arguments_of_several_calls_are_taken_apart_once():
    """One that a function has taken apart fits others; what is written into it in between counts."""
    def added(table, index, x):
        return table.index_select(0, index) + x

    def scaled(index, other):
        return other.index_select(0, index) * 2

    first, second = LaneFunction(added, tables=("table",)), LaneFunction(scaled, tables=("other",))
    table, x = torch.rand(9), torch.rand(9)
    taken, lanes = first.taken(table=table, x=x)
    parts, room = [torch.arange(5, dtype=torch.int32), torch.arange(5, 9, dtype=torch.int32)], torch.empty(9)
    prepared = first.room(room)
    for own, part in zip(x.split([5, 4]), parts):
        assert first.into(prepared, int(part[0]), taken, part, own) is room
    assert torch.equal(room, table + lanes.argument)
    table.mul_(3)
    order = torch.arange(9, dtype=torch.int32)
    assert torch.equal(first(taken, order, lanes), table + lanes.argument)
    assert torch.equal(second(order, taken), table * 2)
    with pytest.raises(ValueError, match="added got tensors of 5 and of 9 lanes"):
        first(taken, parts[0], lanes)
    with pytest.raises(AssertionError):  # lanes are no table
        first(lanes, order, lanes)


def test_arguments_that_come_in_every_call_are_taken_apart_once():
    colours, taken = (torch.rand(7), torch.rand(700)[::100]), []

    class Watched(tuple):
        def __iter__(self):
            taken.append(1)
            return super().__iter__()

    def function(colours, scale, index, x):
        return colours[0].index_select(0, index) * scale + colours[1].index_select(0, index) * x

    fused, watched = LaneFunction(function, tables=("colours",)), Watched(colours)
    index, x, scale = torch.arange(7, dtype=torch.int32), torch.rand(7), 3
    known = fused.knowing(watched, scale)
    expected = function(colours, scale, index, x)
    torch.testing.assert_close(known(watched, scale, index, x), expected)
    while_compiling = len(taken)
    for _ in range(3):
        torch.testing.assert_close(known(watched, scale, index, x), expected)
    assert len(taken) == while_compiling
    # With other arguments, and asked in the plain way, it does the same; all is compiled once.
    torch.testing.assert_close(fused(watched, scale, index, x), expected)
    other = Watched((colours[1], colours[0]))
    torch.testing.assert_close(known(other, scale, index, x), function(other, scale, index, x))
    assert len(fused.compiled) == 1
    with pytest.raises(ValueError, match="7 and of 6 lanes"):
        known(watched, scale, index, x[:6])


class Pose(NamedTuple):
    x: object
    y: object


@pytest.mark.parametrize("first, second", [
    (Point(1.0, 2), Pose(1.0, 2)), (Point(1.0, 2), Point(1.0, 2.0)), (Point(1.0, 2), Point(1.0, True)), ([1], (1,)),
    ((1,), (1, 1)), ("a", "b"), (None, 0), (Point(torch.tensor(3.0), None), Point(None, torch.tensor(3.0))),
    (torch.tensor(3.0), torch.tensor(3.0, dtype=torch.float64)), (torch.tensor(3), 3),
    (torch.tensor(3.0), torch.full((4,), 3.0)),
], ids=str)
def test_arguments_of_another_structure_than_the_last_are_told_apart(first, second):
    fused, seen = LaneFunction(lambda what, x: seen.append(type(what)) or x * 2), []
    for _ in range(3):
        for what in (first, second):
            assert torch.equal(fused(what, torch.ones(4)), torch.full((4,), 2.0))
    assert seen == [type(first), type(second)] and len(fused.compiled) == 2


def test_a_parameter_and_a_tensor_are_the_same_to_a_function():
    fused, x = LaneFunction(lambda x, scale: x * scale), torch.rand(5)
    with torch.no_grad():
        for scale in (torch.tensor(2.0), torch.nn.Parameter(torch.tensor(2.0)), torch.tensor(2.0)):
            assert torch.equal(fused(x, scale), 2 * x)
    assert len(fused.compiled) == 1


def test_tables_that_share_their_memory_are_read_once():
    table, index = torch.rand(9), torch.arange(5, dtype=torch.int32)
    fused = LaneFunction(lambda a, b, i: a.index_select(0, i) + b.index_select(0, i), tables=("a", "b"))
    torch.testing.assert_close(fused(table, table.detach(), index), 2 * table[:5])
    torch.testing.assert_close(fused(table, table.flip(0), index), table[:5] + table.flip(0)[:5])
    assert sorted(len(compiled.inputs) for compiled in fused.compiled.values()) == [2, 3]


def test_derivatives_tell_tables_apart_that_share_their_memory():
    def function(a, b, i):
        a, b = a.index_select(0, i).requires_grad_(), b.index_select(0, i)
        with torch.enable_grad():
            return torch.autograd.grad(a * b * b, [a], torch.ones_like(a))[0]

    table, index = torch.rand(9), torch.arange(5, dtype=torch.int32)
    found = LaneFunction(function, tables=("a", "b"))(table, table.detach(), index)
    torch.testing.assert_close(found, table[:5] ** 2)
