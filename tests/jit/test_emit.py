"""The order in which instructions are written."""

import torch

from torch_radbp.jit import LaneFunction
from torch_radbp.jit.lane.emit import gathers_first


def looked_up_twice(table, index, x):
    root = torch.sqrt(x) + x * 3.0
    return root * table[index] + table[table[index].to(torch.int32)]


def test_gathers_come_before_what_they_do_not_need_and_after_what_they_do():
    function = LaneFunction(looked_up_twice, ("table",))
    values = function.program(torch.arange(5.0), torch.zeros(7, dtype=torch.int32), torch.rand(7)).values
    ordered = gathers_first(values)
    assert len(ordered) == len(values) and set(ordered) == set(values)
    place = {value: number for number, value in enumerate(ordered)}
    assert all(place[argument] < place[value] for value in ordered for argument in value.arguments)
    first, second = sorted(place[value] for value in values if value.operation == "gather")
    assert first < second < min(place[value] for value in values if value.operation in ("sqrt", "mul"))
