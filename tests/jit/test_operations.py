"""Every operation of the lane compiler against torch, on random and on edge values, for every width and number of lanes.

Bit for bit where torch rounds once; sums of products may be fused, which is tested apart.
"""

import math
from functools import partial

import numpy as np
import pytest
import torch

from tests.jit.edge_values import assert_same, pairs
from tests.jit.emulated import emulated
from tests.jit.interpreter import interpreted, needs_interpreter
from tests.jit.quickly import Quick
from torch_radbp.jit import LaneFunction
from torch_radbp.jit.cpu.cpu import Cpu
from torch_radbp.jit.lane.graph import LANES
from torch_radbp.jit.lane.trace import traced_program

TARGETS = {str(width): Cpu(width) for width in (1, 4, 8, 16)} | {
    "made quickly": Quick(), "gpu": emulated(),
    "ptx": pytest.param(interpreted(), marks=[needs_interpreter, pytest.mark.deep])}
FLOATS = (torch.float32, torch.float64)
INTEGERS = (torch.int32, torch.int64)


def check(function, *arguments, target=None, tables=()):
    assert_same(LaneFunction(function, tables=tables, target=target)(*arguments), function(*arguments))


def check_each(functions, *arguments, target):
    """All of them in one kernel."""
    together = {1: lambda x: [function(x) for function in functions.values()],
                2: lambda x, y: [function(x, y) for function in functions.values()]}[len(arguments)]
    for name, found in zip(functions, LaneFunction(together, target=target)(*arguments), strict=True):
        print(name)  # the last one printed is the one that fails
        assert_same(found, functions[name](*arguments))


UNARY = {name: getattr(torch, name) for name in ("neg", "abs", "floor", "ceil", "trunc", "round", "isnan", "isinf",
                                                 "isfinite", "sign", "square", "reciprocal")}
BINARY = {name: getattr(torch, name) for name in ("add", "sub", "mul", "div", "maximum", "minimum", "copysign",
                                                  "eq", "ne", "lt", "le", "gt", "ge", "logical_and", "logical_or")}


@pytest.mark.parametrize("target", TARGETS.values(), ids=TARGETS)
@pytest.mark.parametrize("dtype", FLOATS, ids=str)
def test_functions_of_one_float(dtype, target):
    check_each(UNARY, pairs(dtype)[0], target=target)


@pytest.mark.parametrize("target", TARGETS.values(), ids=TARGETS)
@pytest.mark.parametrize("dtype", FLOATS, ids=str)
def test_functions_of_two_floats(dtype, target):
    a, b = pairs(dtype)
    differ = ~((a == 0) & (b == 0))
    extremes = {name: BINARY[name] for name in ("maximum", "minimum")}
    check_each(extremes, a[differ], b[differ], target=target)  # of zeros of both signs torch gives either
    check_each({name: BINARY[name] for name in BINARY if name not in extremes}, a, b, target=target)


@pytest.mark.parametrize("dtype", FLOATS, ids=str)
def test_remainders_of_floats(dtype):
    a, b = pairs(dtype)
    usual = torch.isfinite(a) & torch.isfinite(b) & (a.abs() < 1e6 * b.abs()) & (b.abs() > 1e-30)
    check(lambda x, y: torch.remainder(x, y), a[usual], b[usual])
    check(lambda x, y: torch.fmod(x, y), a[usual], b[usual])


@pytest.mark.parametrize("target", TARGETS.values(), ids=TARGETS)
@pytest.mark.parametrize("dtype", FLOATS, ids=str)
def test_square_roots_are_rounded_exactly(dtype, target):
    """As numpy's; those of torch may be one unit off."""
    x = pairs(dtype)[0]
    with np.errstate(invalid="ignore"):
        assert_same(LaneFunction(lambda x: torch.sqrt(x), target=target)(x), torch.from_numpy(np.sqrt(x.numpy())))


INTEGER = {
    "add": lambda x, y: x + y, "sub": lambda x, y: x - y, "mul": lambda x, y: x * y, "and": lambda x, y: x & y,
    "or": lambda x, y: x | y, "xor": lambda x, y: x ^ y, "not": lambda x, y: ~x, "neg": lambda x, y: -x,
    "abs": lambda x, y: x.abs(), "left": lambda x, y: x << (y & 15), "right": lambda x, y: x >> (y & 15),
    "lt": lambda x, y: x < y, "ge": lambda x, y: x >= y, "eq": lambda x, y: x == y, "maximum": lambda x, y: x.maximum(y),
    "minimum": lambda x, y: x.minimum(y),
    "alpha": lambda x, y: torch.add(x, y, alpha=-7), "rsub": lambda x, y: torch.rsub(x, y, alpha=3),
    "clamp": lambda x, y: x.clamp(-3, 5), "true division": lambda x, y: x / 3, "sign": lambda x, y: x.sign(),
}


@pytest.mark.parametrize("target", TARGETS.values(), ids=TARGETS)
@pytest.mark.parametrize("dtype", INTEGERS, ids=str)
def test_functions_of_integers_wrap_around_as_in_torch(dtype, target):
    check_each(INTEGER, *pairs(dtype), target=target)


@pytest.mark.parametrize("target", TARGETS.values(), ids=TARGETS)
@pytest.mark.parametrize("dtype", INTEGERS, ids=str)
def test_division_of_integers(dtype, target):
    a, b = pairs(dtype)
    large = torch.iinfo(dtype).max - torch.arange(50, dtype=dtype)
    a, b = torch.cat([a, large, -large]), torch.cat([b, large.flip(0) // 3, large])
    defined = (b != 0) & ~((b == -1) & (a == torch.iinfo(dtype).min))
    a, b = a[defined], b[defined]
    check_each({"remainder": torch.remainder, "fmod": torch.fmod,
                "floor": lambda x, y: torch.div(x, y, rounding_mode="floor"),
                "trunc": lambda x, y: torch.div(x, y, rounding_mode="trunc")}, a, b, target=target)


@pytest.mark.parametrize("target", TARGETS.values(), ids=TARGETS)
def test_functions_of_bools(target):
    functions = {name: INTEGER[name] for name in ("and", "or", "xor", "not", "lt", "ge", "mul", "add")}
    check_each(functions, *pairs(torch.bool), target=target)


@pytest.mark.parametrize("target", TARGETS.values(), ids=TARGETS)
@pytest.mark.parametrize("have", [*FLOATS, *INTEGERS, torch.bool], ids=str)
def test_conversions(have, target):
    x = pairs(have)[0]
    casts = {str(want): partial(torch.Tensor.to, dtype=want) for want in (*FLOATS, *INTEGERS, torch.bool)}
    integers = {name: casts.pop(name) for name in map(str, INTEGERS)}
    check_each(casts, x, target=target)
    check_each(integers, x[x.abs() < 2**31 - 200] if have.is_floating_point else x, target=target)


@pytest.mark.parametrize("number", [2, 2.5, -0.0, math.inf], ids=str)
@pytest.mark.parametrize("dtype", [*FLOATS, *INTEGERS], ids=str)
def test_python_numbers_have_the_dtype_that_torch_gives_them(number, dtype):
    check_each({"add": lambda x: x + number, "rsub": lambda x: number - x, "mul": lambda x: x * number,
                "lt": lambda x: x < number, "or": lambda x: torch.where(x > 0, x, number),
                "either": lambda x: torch.where(x > 0, number, 0)}, pairs(dtype)[0], target=None)


@pytest.mark.parametrize("target", TARGETS.values(), ids=TARGETS)
@pytest.mark.parametrize("dtype", [*FLOATS, *INTEGERS, torch.bool], ids=str)
@pytest.mark.parametrize("at", INTEGERS, ids=str)
def test_tables_are_read_at_indices(dtype, at, target):
    table = pairs(dtype)[0]
    index = torch.randint(len(table), (1003,), generator=torch.Generator().manual_seed(2)).to(at)
    function = LaneFunction(lambda table, i: [table.index_select(0, i), table[i]], tables=("table",), target=target)
    for found in function(table, index):
        assert_same(found, table[index])


@pytest.mark.parametrize("target", TARGETS.values(), ids=TARGETS)
@pytest.mark.parametrize("at", INTEGERS, ids=str)
def test_tables_of_bools_may_begin_and_end_at_any_byte(at, target):
    whole = torch.rand(77, generator=torch.Generator().manual_seed(4)) < 0.5
    function = LaneFunction(lambda table, i: table.index_select(0, i), tables=("table",), target=target)
    for first in range(5):
        table = whole[first:70 + first]
        index = torch.arange(70, dtype=at).flip(0)
        assert_same(function(table, index), table.index_select(0, index))


@pytest.mark.parametrize("target", TARGETS.values(), ids=TARGETS)
@pytest.mark.parametrize("dtype", FLOATS, ids=str)
def test_bits_can_be_read_as_another_dtype(dtype, target):
    integer = {torch.float32: torch.int32, torch.float64: torch.int64}[dtype]
    check(lambda x: x.view(integer), pairs(dtype)[0], target=target)
    check(lambda x: (x.view(integer) ^ 1).view(dtype).abs(), pairs(dtype)[0], target=target)


@pytest.mark.parametrize("exponent", [-2, -1, 0, 1, 2, 3, 5, 0.5])
def test_powers(exponent):
    x = torch.rand(1000, dtype=torch.float64) + 0.1
    torch.testing.assert_close(LaneFunction(lambda x: x**exponent)(x), x**exponent, rtol=1e-15, atol=0)


@pytest.mark.parametrize("dtype", FLOATS, ids=str)
def test_powers_of_small_integers_are_products(dtype):
    program = traced_program(lambda x: [x**3, x.square(), torch.pow(x, -2)], [dtype], [LANES])
    assert {value.operation for value in program.values} == {"input", "constant", "mul", "div"}


@pytest.mark.parametrize("dtype, tolerance", [(torch.float32, 1e-6), (torch.float64, 1e-15)], ids=str)
def test_general_powers(dtype, tolerance):
    x, y = torch.rand(2, 1000, dtype=dtype).unbind(0)
    found = LaneFunction(lambda x, y: x ** (4 * y))(x, y)
    torch.testing.assert_close(found, x ** (4 * y), rtol=tolerance, atol=0)


@pytest.mark.parametrize("dtype", FLOATS, ids=str)
def test_only_products_and_sums_may_be_fused(dtype):
    a, b = pairs(dtype)
    usual = torch.isfinite(a * b)
    found = LaneFunction(lambda a, b: a * b + 1.0)(a, b)[usual]
    expected = (a * b + 1.0)[usual]
    assert ((found - expected).abs() <= torch.finfo(dtype).eps * ((a * b)[usual].abs() + expected.abs())).all()


@pytest.mark.parametrize("target", TARGETS.values(), ids=TARGETS)
@pytest.mark.parametrize("dtype", FLOATS, ids=str)
def test_places_in_sorted_tables(dtype, target):
    """Of any length, which is not compiled in."""
    edges = torch.tensor([-1.0, 0.0, 2.0, math.inf, -math.inf], dtype=dtype)
    function = LaneFunction(lambda table, x: torch.searchsorted(table, x, right=True), tables=("table",), target=target)
    for length in (1, 2, 3, 4, 7, 8, 64, 65, 1000, 1001):
        table = torch.sort(torch.rand(length, generator=torch.Generator().manual_seed(length), dtype=dtype))[0]
        x = torch.cat([table, table + 1e-3, edges, torch.rand(100).to(dtype)])
        assert torch.equal(function(table, x), torch.searchsorted(table, x, right=True)), length
    assert len(function.compiled) == 1
