"""Sums of the lanes' numbers in the entries of tables, by the machine code for it."""

import threading
import time

import pytest
import torch

from tests.jit.programs import addition
from torch_radbp.jit.cpu.cpu_scatter import BLOCK, SHARED
from torch_radbp.jit.recording.addition import side_by_side
from torch_radbp.jit.scatter import Sums, scatter_add
from torch_radbp.threads.made_once import made_once
from torch_radbp.threads.team import alone_in_torch

LANES = (0, 1, 17, BLOCK, BLOCK + 1, 50_000)


@pytest.mark.parametrize("lanes", LANES)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
def test_totals_are_those_of_float64(lanes, dtype):
    cases = [addition(lanes, entries, tables, copies, dtype)
             for entries, tables, copies in ((1, 1, 4), (4, 3, 8), (700, 2, 1), (100_000, 3, 1))]
    scatter_add(cases)
    scatter_add(cases[:1])  # once more
    for case, times in zip(cases, (2, 1, 1, 1)):
        for numbers, totals in zip(case.numbers, case.sums.totals):
            expected = torch.zeros(len(totals), dtype=torch.float64).index_add_(0, case.index, times * numbers.double())
            torch.testing.assert_close(totals.sum(1), expected, rtol=1e-13, atol=1e-13)  # of another order of the sum
        pages = torch.zeros_like(case.sums.touched).index_fill_(0, case.index.long() // 16, True)
        assert torch.equal(case.sums.touched, pages)


@pytest.mark.parametrize("entries, copies", [(4, 4), (1000, 1)])
def test_totals_may_be_columns_of_rows(entries, copies):
    case = addition(5000, entries, 3, copies, torch.float32)
    rows = torch.zeros(entries, 3 * copies, dtype=torch.float64)
    scatter_add([case._replace(sums=Sums(rows.split(copies, 1), case.sums.touched.clone())), case])
    assert torch.equal(rows, torch.cat(case.sums.totals, 1)) and rows.abs().max() > 0


def test_without_copies_lanes_are_added_in_their_order():
    case = addition(10_000, 3, 1, 1, torch.float32)
    scatter_add([case])
    totals = [0.0] * 3
    for index, number in zip(case.index.tolist(), case.numbers[0].tolist()):
        totals[index] += number
    assert case.sums.totals[0].squeeze(1).tolist() == totals


def test_additions_to_the_same_tables_stay_in_one_group_and_in_their_order():
    a, b, c = (addition(5, 7, 1, 1, torch.float32) for _ in range(3))
    both = a._replace(numbers=[*a.numbers, *b.numbers], sums=Sums([*a.sums.totals, *b.sums.totals], a.sums.touched))
    groups = side_by_side([a, c, b, both, b])
    assert [list(map(id, group)) for group in groups] == [list(map(id, group)) for group in ([a, b, both, b], [c])]
    assert side_by_side([]) == []


def test_sums_have_the_same_bits_on_any_number_of_threads():
    def totals(threads: int) -> list[torch.Tensor]:
        cases = [addition(3 * SHARED, entries, 2, 1, torch.float32) for entries in (1, 5, 3000)]
        with alone_in_torch(threads=threads):
            scatter_add([*cases, *cases])
        return [total for case in cases for total in case.sums.totals]

    expected = totals(1)
    assert all(total.abs().max() > 0 for total in expected)
    for threads in (2, 3):
        assert all(map(torch.equal, totals(threads), expected))


def test_parts_and_strided_numbers_are_added_too():
    case = addition(1000, 5, 1, 1, torch.float32)
    index, numbers = torch.arange(200, dtype=torch.int32)[::2] % 5, torch.rand(1).expand(100)
    scatter_add([case._replace(index=index, numbers=[numbers])])
    torch.testing.assert_close(case.sums.totals[0].squeeze(1), torch.zeros(5, dtype=torch.float64).index_add_(0, index,
                                                                                                     numbers.double()))


def test_additions_that_do_not_fit_are_errors():
    good = addition(10, 5, 1, 1, torch.float32)
    for bad in (good._replace(index=good.index.long()), good._replace(numbers=[torch.rand(9)]),
                good._replace(numbers=[torch.ones(10, dtype=torch.int32)]), good._replace(numbers=good.numbers * 2),
                good._replace(numbers=[torch.rand(10, device="meta")])):
        with pytest.raises(ValueError, match="an addition takes int32 indices of 10 lanes"):
            scatter_add([bad])
    with pytest.raises(ValueError, match="indices of 10 lanes"):
        scatter_add([good, addition(11, 5, 1, 1, torch.float32)])


def test_sums_that_do_not_fit_are_errors():
    right, touched = torch.zeros(5, 1, dtype=torch.float64), torch.zeros(1, dtype=torch.bool)
    for totals, pages in (([torch.zeros(5, 3, dtype=torch.float64)], touched), ([torch.zeros(5, 1)], touched),
                          ([right] * 4, touched), ([right, right[:4]], touched), ([right], touched[:0]),
                          ([torch.zeros(5, 2, dtype=torch.float64)[:, :1], right], touched), ([right.to("meta")], touched),
                          ([torch.zeros(2, 5, dtype=torch.float64).T], touched)):
        with pytest.raises(ValueError, match="up to 3 totals .K, C. of float64, C a power of 2"):
            Sums(totals, pages)


def test_threads_that_ask_at_the_same_time_share_one_machine_code():
    """Two of them would free what one is running."""
    made, ready = [], threading.Barrier(4)

    @made_once
    def make(number):
        time.sleep(0.01)
        made.append(number)
        return object()

    def ask():
        ready.wait()
        found.append(make(7))

    found = []
    threads = [threading.Thread(target=ask) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert made == [7] and len(set(map(id, found))) == 1 and make(8) is not found[0]
