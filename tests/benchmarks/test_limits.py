"""The work of a loop that is compared with the machine's limits."""

import torch

from benchmarks.limits import Work, watched, without_reads
from torch_radbp.jit import LaneFunction
from torch_radbp.threads.later import Later


def test_work_of_a_loop_is_counted():
    """x * 2 + table[index]: 4 bytes of x, 4 of the index and 4 of the result a lane; 2 operations and 1 gather."""
    function = LaneFunction(lambda table, x, index: x * 2.0 + table[index], ("table",))
    arguments = torch.rand(5), torch.rand(100), torch.zeros(100, dtype=torch.int32)
    expected = function(*arguments)
    with watched({}) as loops:
        assert torch.equal(function(*arguments), expected)
        function(*arguments)
    (work,) = loops.work.values()
    assert work == Work(moved=2 * 100 * 12.0, operations=2 * 100 * 2.0, gathers=2 * 100.0)
    assert sum(loops.seconds.values()) > 0 and sum(loops.unread.values()) > 0


def test_a_loop_without_its_gathers_reads_zeros():
    """x * 2 + table[index] with 0 in the stead of the table, also where its entries are bools."""
    def function(table, flags, x, index):
        return x * 2.0 + table[index] + flags[index]

    arguments = torch.rand(5), torch.ones(5, dtype=torch.bool), torch.rand(100), torch.zeros(100, dtype=torch.int32)
    function = LaneFunction(function, ("table", "flags"))
    compiled, given = function.prepared(arguments)
    found = torch.empty(100)
    compiled.loop = Later(lambda: without_reads(function.program(*arguments)))
    compiled.run(given, [found.data_ptr()])
    assert torch.equal(found, arguments[2] * 2.0)
