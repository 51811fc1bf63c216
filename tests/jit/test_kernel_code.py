"""Machine code of both kinds computes the same bits, and a kernel gets the better one once it has had enough lanes."""

import numpy as np
import pytest
import torch

from tests.jit.edge_values import assert_same, pairs
from tests.jit.programs import arguments, mixed
from torch_radbp.jit import LaneFunction, compiled, run
from torch_radbp.jit.cpu import kernel_code
from torch_radbp.jit.cpu.cpu import Cpu
from torch_radbp.jit.cpu.kernel_code import ENOUGH, Ahead, CpuLoop, KernelCode


class Quick(Cpu):
    """The CPU, by code that is made quickly."""

    def compile(self, program) -> CpuLoop:
        return CpuLoop(KernelCode.made(self.text(program), well=False).packed())


def sums(x, y, z):
    """Products that are fused with a sum, and some that must not be, since they are needed themselves."""
    product = x * y
    return (x * z + y, y - z * x, x * z - y, -(x * z) + y, y - -(z * z), x * x + y * y, x * y - z * z, (x + y) * (z - x) + z,
            product + z, product - y, product)


@pytest.fixture
def made(monkeypatch) -> list[bool]:
    """Of all code that is made in the test, whether it is made well."""
    found, make = [], kernel_code.object_code
    monkeypatch.setattr(kernel_code, "object_code", lambda text, well: found.append(well) or make(text, well))
    monkeypatch.setattr(Ahead, "lanes", 0)
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
    """In float64 products of float32 are exact, and so are these sums."""
    x, y, z = torch.tensor(np.float32([[1 + 2**-12, 3.0, -1 + 2**-11], [1 - 2**-12, 1 / 3, 1.0], [-1.0, -1.0, 1.0]]))
    exact = [each.double() for each in (x, y, z)]
    found = LaneFunction(sums, target=target)(x, y, z)
    fused, rounded = sums(*exact)[:6], sums(x, y, z)[6:]
    for each, expected in zip(found[:5], fused):
        assert_same(each, expected.float())
    assert not torch.equal(found[0], sums(x, y, z)[0])
    for each, expected in zip(found[8:], rounded[2:]):
        assert_same(each, expected)


def test_code_is_made_quickly_and_well_once_it_has_had_enough_lanes(made):
    function, given = LaneFunction(mixed, tables=("colours",)), arguments(1000)
    expected = function(*given)
    loop = function.prepared(given)[0].loop.result()
    first = loop.address
    assert made == [False]
    for _ in range(ENOUGH // 1000 - 1):
        loop.takes(1000)
    assert loop.improving is None
    loop.takes(1000)
    loop.takes(1000)
    loop.improving.result()
    assert made == [False, True] and loop.address != first and not loop.takes(1000)
    found = function(*given)
    assert_same(found[0].x, expected[0].x)
    assert_same(found[2], expected[2])


def test_code_is_made_well_at_once_for_a_rendering_that_has_enough(made):
    Ahead.are(ENOUGH)
    LaneFunction(mixed, tables=("colours",))(*arguments(1000))
    assert made == [True]


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


def test_a_loop_that_nobody_can_keep_improves_all_the_same(made, monkeypatch):
    monkeypatch.setattr(compiled, "code_name", lambda *given: None)
    loop = LaneFunction(mixed, tables=("colours",)).prepared(arguments(100))[0].loop.result()
    loop.takes(ENOUGH)
    loop.improving.result()
    assert not loop.takes(1)
