"""Reads of tables: in a window of vectors, of whole rows, and one by one, find the same entries."""

import ctypes
import mmap
from itertools import product

import pytest
import torch

from tests.jit.emulated import emulated
from torch_radbp.jit import LaneFunction
from torch_radbp.jit.cpu.cpu import Cpu
from torch_radbp.jit.cpu.machine import host_width
from torch_radbp.jit.lane.emit import emit
from torch_radbp.jit.lane.window import TableWindow
from torch_radbp.tensors.interleaved import LEAST, interleaved
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.record import leaves_of

LANES = 1000
DTYPES = (torch.float32, torch.int32, torch.bool, torch.float64)


def looked_up(tables, index):
    return lookup(tables, index)


def tables_of(entries: int) -> tuple[torch.Tensor, ...]:
    """Tables of every dtype, two of each; entries differ."""
    generator = torch.Generator().manual_seed(entries)
    return tuple(torch.randint(1000, (entries,), generator=generator).to(dtype) if dtype != torch.bool else
                 torch.rand(entries, generator=generator) < 0.5 for dtype in DTYPES for _ in range(2))


def indices(entries: int, kind: str) -> torch.Tensor:
    """(LANES,) int32: all over the table, near each other, or both, block by block, the last entry among them."""
    generator = torch.Generator().manual_seed(1)
    anywhere = torch.randint(entries, (LANES,), generator=generator)
    start = torch.randint(entries, (-(-LANES // 16),), generator=generator).repeat_interleave(16)[:LANES]
    near = (start + torch.randint(32, (LANES,), generator=generator)).clamp_max(entries - 1)
    mixed = torch.where(torch.arange(LANES) // 64 % 2 == 0, anywhere, near)
    found = {"anywhere": anywhere, "near": near, "mixed": mixed}[kind].to(torch.int32)
    found[-1] = found[77] = entries - 1
    return found


# A block is of one vector of the processor, or two.
WIDTHS = [None, *(width for width in (4, 8, 16, 32) if width <= 2 * host_width())]


@pytest.mark.parametrize("width", WIDTHS)
def test_entries_are_those_of_the_table(width):
    """Of tables of any length, which is not compiled in."""
    function = LaneFunction(looked_up, ("tables",), target=Cpu(width))
    for entries, kind in product([1, 5, 31, 32, 33, 1000], ["anywhere", "near", "mixed"]):
        tables, index = tables_of(entries), indices(entries, kind)
        for place in (index, index.long()):
            found = function(tables, place)
            assert all(torch.equal(one, table[index]) for one, table in zip(found, tables)), (entries, kind, place.dtype)
    assert len(function.compiled) == 2


@pytest.mark.parametrize("lanes", [1, 5, 15, 17])
def test_few_lanes_read_the_same(lanes):
    tables, index = tables_of(40), indices(40, "mixed")[:lanes]
    found = LaneFunction(looked_up, ("tables",))(tables, index)
    assert all(torch.equal(one, table[index]) for one, table in zip(found, tables))


@pytest.mark.parametrize("width", [None, 1, 4, 8, 16, 32])
@pytest.mark.parametrize("columns", [2, 3, 5, 8])
def test_rows_hold_the_entries_of_their_columns(columns, width):
    tables = tuple(table for table in (*tables_of(LEAST), *tables_of(LEAST + 1)) if table.itemsize == 4)
    tables = tuple(table[:LEAST] * (1 + place) for place, table in enumerate(tables * 2))[:columns]
    rows, index = interleaved(tables), indices(LEAST, "anywhere")
    assert not any(table.is_contiguous() for table in rows) and all(map(torch.equal, rows, tables))
    function = LaneFunction(looked_up, ("tables",), target=Cpu(width))
    for place in (index, index.long()):
        found = function(rows, place)
        assert all(torch.equal(one, table[index]) for one, table in zip(found, tables))
    assert all(map(torch.equal, function(rows[1:], index), (table[index] for table in tables[1:])))


def test_kernels_read_columns_of_rows():
    tables, index = tuple(torch.rand(LEAST) for _ in range(3)), indices(LEAST, "anywhere")
    found = LaneFunction(looked_up, ("tables",), target=emulated())(interleaved(tables), index)
    assert all(map(torch.equal, found, (table[index] for table in tables)))


def test_a_function_serves_rows_and_columns_apart():
    function, index = LaneFunction(looked_up, ("tables",)), indices(LEAST, "anywhere")
    tables = tuple(torch.rand(LEAST) for _ in range(4))
    for laid_out in (tables, interleaved(tables), interleaved(tables[:2]) + tables[2:], tables):
        assert all(map(torch.equal, function(laid_out, index), (table[index] for table in tables)))


@pytest.mark.parametrize("stride", [2, 3, 100])
def test_columns_of_other_memory_are_read_as_they_lie(stride):
    """If rows are long they are copied."""
    memory, index = torch.rand(50, stride), indices(50, "anywhere")
    found = LaneFunction(looked_up, ("tables",))(tuple(memory.unbind(1))[:2], index)
    assert all(map(torch.equal, found, (memory[index, 0], memory[index, 1])))


@pytest.mark.parametrize("entries", [1, 7, 40])
def test_nothing_beyond_a_table_is_read(entries):
    """The table ends where memory does: to read on would end the process."""
    page = mmap.PAGESIZE
    memory = mmap.mmap(-1, 2 * page)
    address = ctypes.addressof(ctypes.c_char.from_buffer(memory))
    protect = ctypes.CDLL(None).mprotect
    protect.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int]
    assert protect(address + page, page, 0) == 0
    tables = tuple(torch.frombuffer(memory, dtype=dtype, count=entries, offset=page - entries * dtype.itemsize)
                   for dtype in (torch.float32, torch.int32, torch.bool))
    tables[0].copy_(torch.arange(entries))
    index = indices(entries, "near")
    found = LaneFunction(looked_up, ("tables",))((*tables, tables[0][:entries]), index)
    assert torch.equal(found[0], index.float())
    for width in (2, 3, 5):
        rows = torch.frombuffer(memory, dtype=torch.float32, count=entries * width, offset=page - 4 * entries * width)
        rows = rows.view(entries, width).copy_(torch.rand(entries, width))
        found = LaneFunction(looked_up, ("tables",))(rows.unbind(1), index)
        assert all(map(torch.equal, found, rows[index].unbind(1)))
    protect(address + page, page, mmap.PROT_READ | mmap.PROT_WRITE)


@pytest.mark.parametrize("window, words", [(TableWindow(16, True), "vpermi2var"), (TableWindow(8, False), "permd")])
def test_a_window_is_looked_for_where_several_tables_are_read(window, words):
    tables, index = tables_of(40), indices(40, "near")
    program = LaneFunction(looked_up, ("tables",)).program(tables, index)
    assert any(words in line for line in emit(program, 16, window).block)
    assert not any(words in line for line in emit(program, 16).block)
    alone = LaneFunction(looked_up, ("tables",)).program(tables[:1], index)
    assert not any(words in line for line in emit(alone, 16, window).block)


def test_derivatives_reach_tables_in_rows():
    tables = tuple(torch.rand(LEAST, requires_grad=place != 1) for place in range(3))
    rows = interleaved(tables)
    assert [row.requires_grad for row in rows] == [True, False, True]
    sum((place + 1.0) * row.sum() for place, row in enumerate(leaves_of(rows))).backward()
    assert tables[1].grad is None and all(bool((tables[k].grad == k + 1.0).all()) for k in (0, 2))


def test_in_forward_mode_tables_stand_apart():
    with torch.autograd.forward_ad.dual_level():
        dual = torch.autograd.forward_ad.make_dual(torch.rand(LEAST), torch.ones(LEAST))
        rows = interleaved((dual, torch.rand(LEAST)))
        assert all(row.is_contiguous() for row in rows)
        assert torch.autograd.forward_ad.unpack_dual(rows[0]).tangent is not None
