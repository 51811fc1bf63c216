"""Machine code of both kinds computes the same bits, and a kernel gets the better one once it has had enough lanes."""

import pytest
import torch

from tests.jit.edge_values import assert_same, pairs
from tests.jit.programs import arguments, mixed
from tests.jit.quickly import Quick
from torch_radbp.jit import LaneFunction, compiled, run
from torch_radbp.jit.cpu import kernel_code
from torch_radbp.jit.cpu.cpu import Cpu
from torch_radbp.jit.cpu.kernel_code import ENOUGH, LEAST, LONGEST, MANY, Ahead, CpuLoop, KernelCode


def sums(x, y, z):
    """Products that are fused with the sum that they enter, two in a sum, and some that must not be: they are needed."""
    product = x * y
    return (x * z + y, y - z * x, x * x - y, -(y * z) + x, x - -(y * y), z * y + z * z, (x + y) * (z - x) - z / y,
            product + z, product - y, product)


FUSED = 5  # of these have one product, needed once


@pytest.fixture
def made(monkeypatch) -> list[bool]:
    """Of all code that is made in the test, whether it is made well."""
    found, make = [], kernel_code.object_code
    monkeypatch.setattr(kernel_code, "object_code", lambda text, well: found.append(well) or make(text, well))
    monkeypatch.setattr(Ahead, "paths", 0)
    return found


@pytest.mark.parametrize("width", [1, 4, None])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
def test_fused_sums_have_the_same_bits_in_both(dtype, width):
    a, b = pairs(dtype)
    c = b.flip(0)
    well, quickly = (LaneFunction(sums, target=target)(a, b, c) for target in (Cpu(width), Quick(width)))
    for found, expected in zip(quickly, well, strict=True):
        assert_same(found, expected)


@pytest.mark.parametrize("target", [Cpu(), Quick()], ids=["well", "quickly"])
def test_a_product_that_nothing_else_needs_is_rounded_once_with_its_sum(target):
    """In float64 products of numbers of float32 between 1 and 2 are exact, and so are these sums."""
    x, y, z = given = 1.0 + torch.rand(3, 100, generator=torch.Generator().manual_seed(2))
    found, singly = LaneFunction(sums, target=target)(x, y, z), sums(x, y, z)
    for each, exact, rounded in zip(found[:FUSED], sums(*given.double()), singly):
        assert_same(each, exact.float())
        assert not torch.equal(each, rounded)
    for each, rounded in zip(found[-3:], singly[-3:]):
        assert_same(each, rounded)


def test_code_is_made_quickly_and_well_once_it_has_had_enough_lanes(made):
    function, given = LaneFunction(mixed, tables=("colours",)), arguments(1000)
    expected = function(*given)
    loop = function.prepared(given)[0].loop.result()
    first = loop.address
    assert made == [False]
    for _ in range(2):
        loop.takes((ENOUGH - LEAST) // 2 - 1000)
    assert loop.improving is None
    loop.takes(2000)
    loop.improving.result()
    assert made == [False, True] and loop.address != first and not loop.takes(1000)
    found = function(*given)
    assert_same(found[0].x, expected[0].x)
    assert_same(found[2], expected[2])


def test_a_kernel_that_runs_often_is_made_well_though_it_has_few_lanes(made, monkeypatch):
    monkeypatch.setattr(kernel_code, "ENOUGH", 4 * LEAST)
    function, given = LaneFunction(mixed, tables=("colours",)), arguments(10)
    for _ in range(3):
        function(*given)
    loop = function.prepared(given)[0].loop.result()
    assert loop.improving is None
    function(*given)
    loop.improving.result()
    assert made == [False, True]


def test_code_is_made_well_at_once_for_a_rendering_of_many_paths(made):
    function, other = (LaneFunction(mixed, tables=("colours",)) for _ in range(2))
    function(*arguments(1000))
    Ahead.are(MANY - 1)
    function(*arguments(1000))
    assert made == [False]
    Ahead.are(MANY)
    other(*arguments(1000))
    assert made == [False, True]
    function(*arguments(1000))
    function.prepared(arguments(1000))[0].loop.result().improving.result()
    assert made == [False, True, True]


def test_long_kernels_are_made_well_at_once(made):
    """The stack of a thread may be a megabyte."""
    text = Cpu().text(LaneFunction(mixed, tables=("colours",)).program(*arguments(9)))
    for lines in (0, LONGEST):
        KernelCode.first(text + lines * "; a comment\n")
    assert made == [False, True]


def test_better_code_takes_the_place_of_the_first_on_disk(made, tmp_path, monkeypatch):
    """Another process finds it, and has nothing to make; until then it finds the first, and improves that."""
    monkeypatch.setenv("RADBP_KERNEL_CACHE", str(tmp_path))
    traced, trace = [], run.traced_program
    monkeypatch.setattr(run, "traced_program", lambda *given: traced.append(1) or trace(*given))

    def loop() -> CpuLoop:
        found = LaneFunction(mixed, tables=("colours",)).prepared(arguments(100))[0]
        return found.loop.result()

    assert loop().may_improve and loop().may_improve and made == [False]
    again = loop()
    again.takes(ENOUGH)
    again.improving.result()
    assert made == [False, True] and len(traced) == 1
    assert not loop().may_improve and made == [False, True] and len(traced) == 1
    assert len(list(tmp_path.glob("*.code"))) == 1


def test_lanes_of_short_processes_add_up(made, tmp_path, monkeypatch):
    monkeypatch.setenv("RADBP_KERNEL_CACHE", str(tmp_path))
    for _ in range(2):
        loop = LaneFunction(mixed, tables=("colours",)).prepared(arguments(100))[0].loop.result()
        assert loop.improving is None
        loop.takes(ENOUGH // 2)
    loop.improving.result()
    assert made == [False, True]


def test_a_loop_that_nobody_can_keep_improves_all_the_same(made, monkeypatch):
    monkeypatch.setattr(compiled, "code_name", lambda *given: None)
    loop = LaneFunction(mixed, tables=("colours",)).prepared(arguments(100))[0].loop.result()
    loop.takes(ENOUGH)
    loop.improving.result()
    assert not loop.takes(1)
