"""The gradients of tables from the reads of lanes, of one worker and of several."""

import ctypes
import os
import sys

import pytest
import torch

from torch_radbp.adjoint.scatter import Contribution, Gradients, blocks_of, gradients_of
from torch_radbp.jit.cpu.cpu import SMALL
from torch_radbp.tensors.interleaved import LEAST, are_columns, columns_of_rows

LENGTHS = (1, 4, 511, 513, SMALL, SMALL + 1, 200_000)


def contributions(tables: list[torch.Tensor], lanes: int, seed: int) -> list[Contribution]:
    """Four reads of each table, of which those of tables of equal length share the index."""
    generator = torch.Generator().manual_seed(seed)
    index = {(len(table), read): torch.randint(len(table), (lanes,), generator=generator, dtype=torch.int32)
             for table in tables for read in range(4)}
    return [Contribution(leaf, index[len(table), read], torch.randn(lanes, generator=generator, dtype=table.dtype))
            for read in range(4) for leaf, table in enumerate(tables)]


def expected(tables: list[torch.Tensor], parts: list[Contribution]) -> list[torch.Tensor]:
    totals = [torch.zeros(len(table), dtype=torch.float64) for table in tables]
    for leaf, index, adjoint in parts:
        totals[leaf].index_add_(0, index, adjoint.double())
    return totals


@pytest.mark.parametrize("length", LENGTHS)
@pytest.mark.parametrize("dtype, rtol", [(torch.float32, 1e-7), (torch.float64, 1e-13)], ids=str)
def test_each_entry_gets_what_its_readers_found(length, dtype, rtol):
    tables = [torch.empty(length, dtype=dtype) for _ in range(5)] + [torch.empty(7, dtype=dtype)]
    workers, parts = [Gradients(tables) for _ in range(3)], []
    for worker, gradients in enumerate(workers):
        for chunk in range(2):
            parts += (found := contributions(tables, 3000, 10 * worker + chunk))
            gradients.add(found)
    for found, total in zip(gradients_of(workers)[0], expected(tables, parts)):
        assert found.dtype == dtype and found.shape == total.shape
        torch.testing.assert_close(found.double(), total, rtol=rtol, atol=1e-12)


def test_a_total_keeps_what_is_small_against_it():
    """A million lanes of 1e-4 beside one of 1e5 come to 100; in float32 they vanish."""
    for length in (2, SMALL + 1):
        gradients = Gradients([torch.empty(length)])
        lanes = torch.full((1_000_001,), 1e-4)
        lanes[0] = 1e5
        gradients.add([Contribution(0, torch.ones(len(lanes), dtype=torch.int32), lanes)])
        assert gradients_of([gradients])[0][0][1].item() == pytest.approx(1e5 + 100, rel=1e-7)


def resident(tensor: torch.Tensor) -> int:
    """The bytes of a tensor that are in memory."""
    page = os.sysconf("SC_PAGESIZE")
    first, last = tensor.data_ptr() // page, -(-(tensor.data_ptr() + tensor.nbytes) // page)
    found = (ctypes.c_ubyte * (last - first))()
    assert ctypes.CDLL(None).mincore(ctypes.c_void_p(first * page), ctypes.c_size_t((last - first) * page), found) == 0
    return bytes(found).count(1) * page


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="mincore tells what is in memory on Linux")
def test_pages_that_nobody_reads_take_no_memory():
    table = torch.empty(1).expand(1 << 28)  # so many that the allocator has none to give that were used before
    gradients = Gradients([table])
    gradients.add([Contribution(0, torch.arange(5000, dtype=torch.int32) + (1 << 25), torch.ones(5000))])
    gradient, = gradients_of([gradients])[0]
    for tensor in (gradients.totals[0], gradient):
        assert tensor.nbytes >= 1 << 30 and 0 < resident(tensor) <= 16 << 20  # pages of the system may be of 2 MiB
    assert gradient[(1 << 25) - 1:][:3].tolist() == [0, 1, 1]


@pytest.mark.parametrize("length", [LEAST, 100_000])
def test_gradients_of_columns_of_rows_are_columns_of_rows(length):
    """So that the rows' own gradient is that memory, without a copy; a part of the columns stands apart."""
    rows = torch.rand(length, 3, requires_grad=True)
    attached = columns_of_rows(rows)
    tables = [table.detach() for table in attached]
    parts = contributions(tables, 3000, 1)
    for left_out in (0, 1):
        some, gradients = tables[left_out:], Gradients(tables[left_out:])
        own = [part._replace(leaf=part.leaf - left_out) for part in parts if part.leaf >= left_out]
        gradients.add(own)
        found, finite = gradients_of([gradients])
        for gradient, total in zip(found, expected(some, own), strict=True):
            torch.testing.assert_close(gradient.double(), total, rtol=1e-7, atol=1e-12)
        assert are_columns(found, rows.shape) == (not left_out)
        assert finite and max(float(gradient.abs().max()) for gradient in found) > 0
    found, _ = gradients_of([Gradients([table.detach() for table in attached])])
    torch.autograd.backward(attached, found)
    assert rows.grad.data_ptr() == found[0].data_ptr()


@pytest.mark.parametrize("value", [float("inf"), float("nan"), 1e300])
def test_gradients_that_are_not_finite_are_noticed(value):
    """Also those that only float32 cannot hold."""
    for length in (3, 100_000):
        gradients = Gradients([torch.empty(length), torch.empty(7)])
        gradients.add([Contribution(0, torch.tensor([1, 2], dtype=torch.int32), torch.tensor([1.0, value]).double())])
        found, finite = gradients_of([gradients])
        assert not finite and found[0][1] == 1 and not torch.isfinite(found[0][2])
        assert gradients_of([Gradients([torch.empty(length)])])[1]


def test_numbers_whole_tables_and_tables_without_entries_have_gradients_too():
    tables = [torch.empty(()), torch.empty(3), torch.empty(0)]
    gradients = Gradients(tables)
    gradients.add_whole(0, torch.tensor(2.0))
    gradients.add_whole(0, torch.tensor(2.5))
    gradients.add_whole(1, torch.tensor([1.0, 2.0, 3.0]))
    gradients.add([])
    assert [gradient.tolist() for gradient in gradients_of([gradients, Gradients(tables)])[0]] == [4.5, [1, 2, 3], []]


def test_other_devices_get_torch_operations():
    gradients = Gradients([torch.empty(1000, device="meta")])
    gradients.add([Contribution(0, torch.zeros(9, dtype=torch.int32, device="meta"), torch.zeros(9, device="meta"))])
    assert gradients.totals[0].device.type == "meta"


def test_totals_of_small_tables_and_of_parts_of_rows_lie_together():
    small = [torch.zeros(10) for _ in range(5)]
    of_rows = list(torch.zeros(2000, 8)[:, 1:7].unbind(1))
    tables = [*small, *of_rows, torch.zeros(2000), torch.zeros(2001, dtype=torch.float64)]
    assert [block.width for block in blocks_of(tables)] == [5, 6, 1, 1]
    gradients, parts = Gradients(tables), contributions(tables, 3000, 0)
    gradients.add(parts)
    found, finite = gradients_of([gradients])
    assert finite
    for own, table, total in zip(found, tables, expected(tables, parts)):
        assert own.shape == table.shape and own.dtype == table.dtype and total.any()
        torch.testing.assert_close(own.double(), total, rtol=1e-6, atol=1e-6)
