"""The order of a thread's values: what it keeps alive, and that it changes no result."""

from collections.abc import Sequence

import torch

from tests.jit.emulated import Emulated
from torch_radbp.jit import LaneFunction
from torch_radbp.jit.lane.graph import LANES, Program, Value
from torch_radbp.jit.lane.schedule import REGISTERS, few_alive, most_alive
from torch_radbp.jit.lane.trace import traced_program
from torch_radbp.jit.nvidia.gpu import Gpu


def pairs(x, count: int):
    """Sums of neighbours, none of which is begun before all terms of all sums are there."""
    terms = [(x + number) * (x - number) for number in range(2 * count)]
    return [torch.maximum(a, b) for a, b in zip(terms[::2], terms[1::2])]


def traced(count: int) -> Program:
    return traced_program(lambda x: pairs(x, count), [torch.float32], [LANES])


def computed_before_use(values: Sequence[Value]) -> bool:
    place = {value: number for number, value in enumerate(values)}
    return all(place[argument] < place[value] for value in values for argument in value.arguments)


def test_values_are_computed_next_to_where_they_are_used():
    given = traced(200).values
    order = few_alive(given)
    assert most_alive(given) >= 400  # all terms at once
    assert most_alive(order) <= 6
    assert set(order) == set(given) and len(order) == len(given) and computed_before_use(order)


def test_an_order_in_which_all_values_find_room_stays():
    given = traced(60).values
    assert 120 <= most_alive(given) <= REGISTERS
    assert few_alive(given) == list(given)


def test_the_order_is_the_same_each_time():
    first, second = (list(map(repr, few_alive(traced(200).values))) for _ in range(2))
    assert first == second


def test_registers_alive_are_counted_where_most_are():
    program = traced_program(lambda x, y: [(x * y).double() + (x - y).double()], [torch.float32] * 2, [LANES] * 2)
    assert most_alive(program.values) == 5  # one term in float64, the other in both


def test_a_kernel_in_another_order_computes_the_same():
    x = torch.linspace(-3, 5, 300)
    results = LaneFunction(lambda x: pairs(x, 200), target=Gpu(Emulated()))(x)
    expected = pairs(x, 200)
    assert all(wanted.isfinite().all() and wanted.any() for wanted in expected)
    assert all(map(torch.equal, results, expected))
