"""Elementary functions of float64 without a C library, against the C library over the whole range."""

import math

import pytest
import torch

from tests.jit.emulated import emulated
from torch_radbp.jit import LaneFunction
from torch_radbp.jit.lane.elementary_double import FORMULAS
from torch_radbp.jit.lane.graph import LANES
from torch_radbp.jit.lane.lowered import without_library
from torch_radbp.jit.lane.trace import traced_program

RANGES = {  # lowest, highest, greatest error in units in the last place; that of the C library is about 1
    "exp": (-745.0, 709.7, 2), "exp2": (-1074.0, 1023.9, 2), "expm1": (-50.0, 709.7, 2), "log": (5e-324, 1.7e308, 3),
    "log2": (5e-324, 1.7e308, 3), "log10": (5e-324, 1.7e308, 3), "log1p": (-0.9999999, 1.7e308, 3),
    "sin": (-1048576.0, 1048576.0, 2), "cos": (-1048576.0, 1048576.0, 2), "tan": (-1048576.0, 1048576.0, 4),
    "atan": (-1.7e308, 1.7e308, 3), "asin": (-1.0, 1.0, 5), "acos": (-1.0, 1.0, 5), "sinh": (-710.0, 710.0, 5),
    "cosh": (-710.0, 710.0, 5), "tanh": (-1e300, 1e300, 5), "erf": (-1e300, 1e300, 4), "erfc": (-30.0, 26.5, 6)}
EDGES = [0.0, -0.0, 1.0, -1.0, math.inf, -math.inf, math.nan, 5e-324, -5e-324, 1.7e308, -1.7e308, 1e-300]


def doubles(low: float, high: float) -> torch.Tensor:
    """Numbers between `low` and `high`: even steps through their bits, and even steps."""
    largest = torch.tensor(max(abs(low), abs(high)), dtype=torch.float64).view(torch.int64).item()
    size = (torch.arange(100_001) * (largest // 100_000)).view(torch.float64)
    near = torch.linspace(max(low, -1000.0), min(high, 1000.0), 100_001, dtype=torch.float64)
    x = torch.cat([size, -size, near, 0.001 * near])
    return x[(x >= low) & (x <= high)]


def units_off(found: torch.Tensor, exact: torch.Tensor) -> torch.Tensor:
    """Errors in units in the last place."""
    finite = torch.isfinite(exact)
    size = exact[finite].abs().clamp_min(2.0**-1022)
    unit = torch.nextafter(size, torch.tensor(math.inf, dtype=torch.float64)) - size
    return (found[finite] - exact[finite]).abs() / unit


@pytest.mark.parametrize("name", RANGES)
def test_errors_over_the_whole_range(name):
    low, high, most = RANGES[name]
    x, function = doubles(low, high), getattr(torch, name)
    off = units_off(LaneFunction(lambda x: function(x), target=emulated())(x), function(x)).max()
    assert 0 < off <= most, off


def vectors() -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    return tuple(torch.randn(50_000, generator=generator, dtype=torch.float64)
                 * 10 ** torch.empty(50_000, dtype=torch.float64).uniform_(-12, 12, generator=generator) for _ in range(2))


@pytest.mark.parametrize("name, most", [("atan2", 3), ("hypot", 2)])
def test_errors_of_functions_of_vectors(name, most):
    function = getattr(torch, name)
    found = LaneFunction(lambda y, x: function(y, x), target=emulated())(*vectors())
    assert 0 < units_off(found, function(*vectors())).max() <= most


def test_error_of_powers_grows_with_the_exponent_of_the_result():
    x = doubles(1e-300, 1e300)[:50_000]
    y = torch.linspace(-30, 30, len(x), dtype=torch.float64)
    found, exact = LaneFunction(lambda x, y: torch.pow(x, y), target=emulated())(x, y), torch.pow(x, y)
    usual = torch.isfinite(exact) & (exact > 2.0**-1022)
    assert (units_off(found[usual], exact[usual]) <= 2 + 2 * (y * x.log()).abs()[usual]).all()


OVERFLOWS = pytest.mark.skipif(bool(torch.log1p(torch.tensor(1.7e308, dtype=torch.float64)).isinf()),
                               reason="torch 2.6: log1p(1.7e308) is infinite")


@pytest.mark.parametrize("name", [pytest.param("log1p", marks=OVERFLOWS), *sorted(RANGES.keys() - {"log1p"})])
def test_edge_values(name):
    x, function = torch.tensor(EDGES, dtype=torch.float64), getattr(torch, name)
    x = x[x.abs().nan_to_num(0) < 1e300] if name in ("sin", "cos", "tan") else x
    found, expected = LaneFunction(lambda x: function(x), target=emulated())(x), function(x)
    torch.testing.assert_close(found, expected, rtol=1e-14, atol=5e-324, equal_nan=True)
    assert torch.equal(found.signbit()[found == 0], expected.signbit()[found == 0])


@pytest.mark.parametrize("name", ["atan2", "hypot", "pow"])
def test_edge_values_of_two_arguments(name):
    edges, function = torch.tensor([*EDGES[:9], 2.0, -2.0, 3.0, -3.0, 0.5, -0.5], dtype=torch.float64), getattr(torch, name)
    x, y = (column.clone() for column in torch.cartesian_prod(edges, edges).unbind(1))
    found, expected = LaneFunction(lambda x, y: function(x, y), target=emulated())(x, y), function(x, y)
    torch.testing.assert_close(found, expected, rtol=1e-13, atol=0, equal_nan=True)
    assert torch.equal(found.signbit()[found == 0], expected.signbit()[found == 0])


def test_sines_of_large_angles_lose_what_is_stated():
    x = doubles(1e6, 2.0**31)
    for function in (lambda x: torch.sin(x), lambda x: torch.cos(x)):
        found = LaneFunction(function, target=emulated())(x)
        assert ((found - function(x)).abs() <= 2**-51 + x * 2**-85).all()


def test_nothing_of_the_library_is_left():
    program = traced_program(
        lambda x, y: [getattr(torch, name)(x) if name not in ("pow", "atan2", "hypot") else getattr(torch, name)(x, y)
                      for name in FORMULAS], [torch.float64] * 2, [LANES] * 2)
    used = {value.operation for value in program.values}
    assert set(FORMULAS) <= used
    lowered = without_library(program)
    assert not set(FORMULAS) & {value.operation for value in lowered.values}
    assert [value.static for value in lowered.inputs] == [0, 1] and len(lowered.outputs) == len(FORMULAS)
