"""Elementary functions of float32: errors in units in the last place over the whole range, and their coefficients."""

import math

import numpy as np
import pytest
import torch

from tests.jit.emulated import emulated
from torch_radbp.jit import LaneFunction
from torch_radbp.jit.cpu.cpu import Cpu
from torch_radbp.jit.lane import elementary


def floats(low: float, high: float) -> torch.Tensor:
    """Numbers of float32 between `low` and `high`, of both signs, even steps through their bits."""
    largest = torch.tensor(max(abs(low), abs(high)), dtype=torch.float32).view(torch.int32).item()
    size = torch.linspace(0, largest, 400_001, dtype=torch.float64).to(torch.int32).view(torch.float32)
    x = torch.cat([size, -size])
    return x[(x >= low) & (x <= high)]


def units_off(found: torch.Tensor, exact: torch.Tensor) -> float:
    """The largest error in units in the last place of the result as float32."""
    finite = torch.isfinite(exact) & (exact.abs() < 3.4028234e38)
    size = exact[finite].abs().clamp_min(2.0**-126)
    unit = torch.exp2(torch.floor(torch.log2(size)) - 23)
    return float(((found.double()[finite] - exact[finite]).abs() / unit).max())


RANGES = {  # lowest, highest, greatest error allowed
    "exp": (-104.0, 88.7, 1.1), "log": (1e-45, 3.4e38, 0.9), "log1p": (-0.99999, 3.4e38, 2.3),
    "sin": (-32768.0, 32768.0, 1.5), "cos": (-32768.0, 32768.0, 1.5), "tan": (-32768.0, 32768.0, 3.1),
    "atan": (-3.4e38, 3.4e38, 2.7), "asin": (-1.0, 1.0, 3.5), "acos": (-1.0, 1.0, 3.5),
    "erfc": (-6.0, 10.06, 4.0)}


@pytest.mark.parametrize("target", [Cpu(1), Cpu(), emulated()], ids=["single lanes", "vectors", "gpu"])
@pytest.mark.parametrize("name", RANGES)
def test_errors_over_the_whole_range(name, target):
    low, high, most = RANGES[name]
    x, function = floats(low, high), getattr(torch, name)
    found = LaneFunction(lambda x: function(x), target=target)(x)
    off = units_off(found, function(x.double()))
    assert 0.3 < off <= most, off


def test_error_of_the_angle_of_a_vector():
    generator = torch.Generator().manual_seed(0)
    y, x = (torch.randn(400_000, generator=generator) * 10 ** torch.empty(400_000).uniform_(-12, 12, generator=generator)
            for _ in range(2))
    found = LaneFunction(lambda y, x: torch.atan2(y, x))(y, x)
    assert 0.3 < units_off(found, torch.atan2(y.double(), x.double())) <= 2.7


OVERFLOWS = pytest.mark.skipif(bool(torch.log1p(torch.tensor(3.4e38)).isinf()),
                               reason="torch 2.6: log1p(3.4e38) is infinite")


@pytest.mark.parametrize("name", ["exp", "log", pytest.param("log1p", marks=OVERFLOWS), "sin", "cos", "atan", "asin", "acos",
                                  "erfc"])
def test_edge_values(name):
    x = torch.tensor([0.0, -0.0, 1.0, -1.0, math.inf, -math.inf, math.nan, 1e-45, -1e-45, 3.4e38, -3.4e38, 1e-30])
    if name in ("sin", "cos"):
        x = x[x.abs().nan_to_num(0) < 1e38]
    function = getattr(torch, name)
    found, expected = LaneFunction(lambda x: function(x))(x), function(x)
    torch.testing.assert_close(found, expected, rtol=4e-7, atol=1e-45, equal_nan=True)
    zero = found == 0
    assert torch.equal(found[zero].signbit(), expected[zero].signbit())


def test_angles_of_vectors_along_the_axes_and_at_infinity():
    edges = torch.tensor([0.0, -0.0, 1.0, -1.0, math.inf, -math.inf, math.nan, 1e-45])
    y, x = (column.clone() for column in torch.cartesian_prod(edges, edges).unbind(1))
    found, expected = LaneFunction(lambda y, x: torch.atan2(y, x))(y, x), torch.atan2(y, x)
    torch.testing.assert_close(found, expected, rtol=2e-7, atol=1e-45, equal_nan=True)
    assert torch.equal(found.signbit()[found == 0], expected.signbit()[found == 0])


def test_sines_of_large_angles_lose_what_is_stated():
    x = floats(32768.0, 1e9)
    for function in (lambda x: torch.sin(x), lambda x: torch.cos(x)):
        found = LaneFunction(function)(x)
        assert ((found.double() - function(x.double())).abs() <= 2**-23 + x.double() * 2**-52).all()


@pytest.mark.parametrize("name", elementary.IN_LIBRARY)
def test_float64_has_the_accuracy_of_the_c_library(name):
    arguments = torch.rand(2 if name in ("atan2", "hypot", "pow") else 1, 1000, dtype=torch.float64).unbind(0)
    function = getattr(torch, name)
    found = LaneFunction(lambda *x: function(*x))(*arguments) if len(arguments) == 1 else LaneFunction(
        lambda x, y: function(x, y))(*arguments)
    torch.testing.assert_close(found, function(*arguments), rtol=1e-15, atol=1e-16)


@pytest.mark.parametrize("name", ["sinh", "cosh", "tanh", "exp2", "expm1", "log2", "log10", "erf"])
def test_other_functions_of_float32_go_by_float64(name):
    x, function = torch.rand(1000), getattr(torch, name)
    assert units_off(LaneFunction(lambda x: function(x))(x), function(x.double())) <= 0.51


def scaled_tail(t: np.ndarray) -> np.ndarray:
    """exp(x^2) erfc(x) (1 + 2 x) with t = (x - 2) / (x + 2)."""
    x = 2 * (1 + t) / (1 - t)
    return torch.special.erfcx(torch.from_numpy(x)).numpy() * (1 + 2 * x)


# What each polynomial approximates (by its power series near 0), the interval, its weight, its coefficients.
HALF = math.log(2) / 2
POLYNOMIALS = {
    "EXP": (lambda r: (np.expm1(r) - r) / r**2, -HALF, HALF, lambda r: r**2 / np.exp(r)),
    "LOG": (lambda f: (np.log1p(f) - f + f * f / 2) / f**3, 0.5**0.5 - 1, 2**0.5 - 1, lambda f: f**3 / np.log1p(f)),
    "SIN": (lambda s: (np.sin(s**0.5) / s**0.5 - 1) / s, 0, (math.pi / 4) ** 2, lambda s: s**1.5 / np.sin(s**0.5)),
    "COS": (lambda s: (np.cos(s**0.5) - 1 + s / 2) / s**2, 0, (math.pi / 4) ** 2, lambda s: s**2 / np.cos(s**0.5)),
    "ATAN": (lambda s: (np.arctan(s**0.5) / s**0.5 - 1) / s, 0, math.tan(math.pi / 8) ** 2,
             lambda s: s**1.5 / np.arctan(s**0.5)),
    "ERFC": (scaled_tail, -1.0, 8.1 / 12.1, lambda t: 1 / scaled_tail(t)),
}


@pytest.mark.parametrize("name", POLYNOMIALS)
def test_polynomials_are_closer_than_a_quarter_of_a_rounding(name):
    function, low, high, weight = POLYNOMIALS[name]
    x = np.linspace(low, high, 100_001)
    x = x[np.abs(x) > 0.02]  # nearer to 0 float64 cancels; there the weight is next to nothing
    error = (np.polynomial.polynomial.polyval(x, getattr(elementary, name)) - function(x)) * weight(x)
    assert np.abs(error).max() < 2**-26
