"""The work of a loop that is compared with the machine's limits."""

import torch

from benchmarks.limits import Work, watched
from torch_radbp.jit import LaneFunction


def test_work_of_a_loop_is_counted():
    """x * 2 + table[index]: 4 bytes of x, 4 of the index and 4 of the result a lane; 2 operations and 1 gather."""
    function = LaneFunction(lambda table, x, index: x * 2.0 + table[index], ("table",))
    arguments = torch.rand(5), torch.rand(100), torch.zeros(100, dtype=torch.int32)
    expected = function(*arguments)
    with watched() as loops:
        assert torch.equal(function(*arguments), expected)
        function(*arguments)
    (work,) = loops.work.values()
    assert work == Work(moved=2 * 100 * 12.0, operations=2 * 100 * 2.0, gathers=2 * 100.0)
    assert sum(loops.seconds.values()) > 0
