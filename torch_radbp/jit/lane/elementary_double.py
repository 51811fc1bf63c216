"""Elementary functions of float64 by basic operations, for targets without a C library.

Each reduces its argument to a small interval and sums the function's power series there, with so many terms that what is
left out is below a quarter of a rounding; only that of erfc is a polynomial through Chebyshev nodes. Errors in units in the
last place, as `tests/jit/test_elementary_double.py` measures them against the C library:

    exp, exp2, expm1 2    log, log2, log10, log1p 3    sin, cos 2 (tan 4) for |x| <= 2^20    atan2, atan 3    asin, acos 5
    sinh, cosh, tanh 5    erf 4    erfc 6    hypot 2    pow 2 + 2 |y log x|

Beyond 2^20 the absolute error of sin and cos is at most 2^-51 + 2^-85 |x|, and there is none to speak of beyond 2^31.

Reference: Muller 2016, "Elementary Functions: Algorithms and Implementation". Cody and Waite 1980, for the reduction.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
from torch import Tensor

from torch_radbp.jit.lane.angles import angle_functions, log_beyond_1, polynomial

# Parts of ln 2 and of pi / 2; all but the last have few digits, so that their multiples are exact.
LN2_HIGH, LN2_LOW = 0.6931471803691238, 1.9082149292705877e-10
QUARTER_HIGH, QUARTER_MIDDLE, QUARTER_LOW = 1.5707963267341256, 6.077100506303966e-11, 2.0222662487959506e-21

# Coefficients of (exp(r) - 1 - r) / r^2; then, of the square, of (log((1 + s) / (1 - s)) / s - 2) / s^2,
# (sin(x) - x) / x^3, (cos(x) - 1 + x^2 / 2) / x^4, (atan(t) - t) / t^3 and (erf(x) sqrt(pi) / 2 - x) / x^3.
EXP = tuple(1 / math.factorial(k) for k in range(2, 15))
LOG = tuple(2 / (2 * k + 3) for k in range(11))
SIN = tuple((-1) ** (k + 1) / math.factorial(2 * k + 3) for k in range(8))
COS = tuple((-1) ** k / math.factorial(2 * k + 4) for k in range(8))
ATAN = tuple((-1) ** (k + 1) / (2 * k + 3) for k in range(21))
ERF = tuple((-1) ** (k + 1) / math.factorial(k + 1) / (2 * k + 3) for k in range(14))
# Of exp(x^2) erfc(x) (1 + 2 x) for 0 <= x <= 27.3, a polynomial of (x - 4) / (x + 4).
ERFC = (1.2329951186255526, -0.13962111684056253, 0.015379652102620118, 0.06809705425469288, -0.10103906603633005,
        0.09373283499833922, -0.06633036581152832, 0.03716751553777951, -0.01619773406729662, 0.0050319699731140735,
        -0.0007577732124024575, -0.0001992566473845515, 0.00015062129844856044, -2.4399493202292386e-05,
        -1.1220852841433643e-05, 5.710756847215849e-06, 2.915318286008567e-07, -8.277812447092441e-07,
        7.718766469322959e-08, 1.1336495106051056e-07, -1.921223370269995e-08, -1.6708396072534936e-08,
        1.7040516462068893e-09, 2.1459153541118695e-09, 3.033156259574846e-10)


def _power_of_two(exponent: Tensor) -> Tensor:
    """2^exponent of int64 exponents from -1022 to 1023, by setting bits."""
    return ((exponent + 1023) << 52).view(torch.float64)


def _scaled(x: Tensor, exponent: Tensor) -> Tensor:
    """x 2^exponent for exponents that are whole numbers; also where the result is subnormal."""
    whole = exponent.to(torch.int64)
    half = whole >> 1
    return x * _power_of_two(half) * _power_of_two(whole - half)


def expm1_near_zero(x: Tensor) -> Tensor:
    """exp(x) - 1 for |x| <= ln(2) / 2."""
    return x + x * x * polynomial(x, EXP)


def _reduced(x: Tensor) -> tuple[Tensor, Tensor]:
    """x reduced by a multiple of ln 2, and the multiple."""
    exponent = torch.round(x * (1 / math.log(2)))
    return (x - exponent * LN2_HIGH) - exponent * LN2_LOW, exponent


def _exp(x: Tensor) -> Tensor:
    rest, exponent = _reduced(x.clamp(-746.0, 710.0))  # zero and infinity beyond
    return _scaled(1.0 + expm1_near_zero(rest), exponent)


def exp2(x: Tensor) -> Tensor:
    x = x.clamp(-1076.0, 1025.0)
    exponent = torch.round(x)
    return _scaled(1.0 + expm1_near_zero((x - exponent) * math.log(2)), exponent)


def expm1(x: Tensor) -> Tensor:
    rest, exponent = _reduced(x.clamp(-38.0, 710.0))
    part = expm1_near_zero(rest)
    result = _scaled(part, exponent) + (_scaled(torch.ones_like(x), exponent) - 1.0)
    return torch.where(x == 0, x, torch.where(exponent > 60, _scaled(1.0 + part, exponent), result))


def parts_of_log(x: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """exponent, f, f^2 / 2 and the rest r, with log(x) = exponent ln 2 + f - (f^2 / 2 - r)."""
    subnormal = x < 2.0**-1022
    bits = torch.where(subnormal, x * 2.0**54, x).view(torch.int64)
    # The exponent for which the mantissa lies between sqrt(1/2) and sqrt(2).
    exponent = (bits - 0x3FE6A09E667F3BCD) >> 52
    f = (bits - (exponent << 52)).view(torch.float64) - 1.0
    half = 0.5 * f * f
    s = f / (2.0 + f)
    square = s * s
    rest = s * (half + square * polynomial(square, LOG))
    return exponent.to(torch.float64) - torch.where(subnormal, 54.0, 0.0), f, half, rest


def at_the_ends(x: Tensor, result: Tensor) -> Tensor:
    """Completes a logarithm at 0, negative numbers, infinity and NaN; elsewhere it is `result`."""
    result = torch.where(x > 0, result, torch.where(x == 0, -math.inf, math.nan))
    return torch.where(x == math.inf, x, result)


def _log(x: Tensor) -> Tensor:
    exponent, f, half, rest = parts_of_log(x)
    return at_the_ends(x, exponent * LN2_HIGH - ((half - (rest + exponent * LN2_LOW)) - f))


def log2(x: Tensor) -> Tensor:
    exponent, f, half, rest = parts_of_log(x)
    return at_the_ends(x, exponent + (f - (half - rest)) * (1 / math.log(2)))


def log10(x: Tensor) -> Tensor:
    exponent, f, half, rest = parts_of_log(x)
    return at_the_ends(x, exponent * math.log10(2) + (f - (half - rest)) * (1 / math.log(10)))


def _log1p(x: Tensor) -> Tensor:
    return log_beyond_1(x, _log)


def _quadrant(x: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """sin and cos of x reduced by a multiple of pi / 2, and the multiple modulo 4."""
    turns = torch.round(x * (2 / math.pi))
    rest = ((x - turns * QUARTER_HIGH) - turns * QUARTER_MIDDLE) - turns * QUARTER_LOW
    square = rest * rest
    sine = rest + rest * square * polynomial(square, SIN)
    cosine = 1.0 - (0.5 * square - square * square * polynomial(square, COS))
    return sine, cosine, turns - 4.0 * torch.floor(0.25 * turns)


def sinh(x: Tensor) -> Tensor:
    size = x.abs()
    grown = expm1(size.clamp_max(40.0))
    half = _exp(0.5 * size)
    value = torch.where(size < 40.0, 0.5 * (grown + grown / (grown + 1.0)), 0.5 * half * half)
    return torch.where(x == x, torch.copysign(value, x), x)


def cosh(x: Tensor) -> Tensor:
    half = _exp(0.5 * x.abs())
    return 0.5 * half * half + 0.5 / half / half


def tanh(x: Tensor) -> Tensor:
    grown = expm1(2.0 * x.abs().clamp_max(20.0))  # 1 beyond
    return torch.copysign(grown / (grown + 2.0), x)


def _erfc(x: Tensor) -> Tensor:
    size = x.abs().clamp_max(27.3)  # zero beyond
    high = (size.view(torch.int64) & -(1 << 27)).view(torch.float64)  # its square is exact
    tail = _exp(-high * high) * _exp((high - size) * (high + size))
    tail = tail * (polynomial((size - 4.0) / (size + 4.0), ERFC) / (1.0 + 2.0 * size))
    square = x * x
    near = 1.0 - 2 / math.sqrt(math.pi) * (x + x * square * polynomial(square, ERF))
    return torch.where((-0.5 < x) & (x < 0.5), near, torch.where(x < 0, 2.0 - tail, tail))


def erf(x: Tensor) -> Tensor:
    square = x * x
    near = 2 / math.sqrt(math.pi) * (x + x * square * polynomial(square, ERF))
    near = torch.where(x == 0, x, near)
    return torch.where((-0.5 < x) & (x < 0.5), near, torch.copysign(1.0 - _erfc(x.abs()), x))


def hypot(x: Tensor, y: Tensor) -> Tensor:
    ax, ay = x.abs(), y.abs()
    low, high = torch.minimum(ax, ay), torch.maximum(ax, ay)
    slope = torch.where(high == 0, 0.0, low / high)
    length = high * torch.sqrt(1.0 + slope * slope)
    return torch.where((ax == math.inf) | (ay == math.inf), math.inf, length)


def pow(x: Tensor, y: Tensor) -> Tensor:  # noqa: A001 (the operation's name)
    whole = torch.floor(y) == y
    odd = whole & (torch.floor(0.5 * y) != 0.5 * y)
    value = _exp(y * _log(x.abs()))
    negative = torch.copysign(torch.ones_like(x), x) < 0
    value = torch.where(negative & odd, -value, value)
    value = torch.where((x < 0) & ~whole & (x != -math.inf) & (y == y), math.nan, value)
    value = torch.where((x.abs() == 1) & (y.abs() == math.inf), 1.0, value)
    return torch.where((x == 1) | (y == 0), 1.0, value)


FORMULAS: dict[str, Callable[..., Tensor]] = {
    "sinh": sinh, "cosh": cosh, "tanh": tanh, "exp": _exp, "exp2": exp2, "expm1": expm1, "log": _log, "log2": log2,
    "log10": log10, "log1p": _log1p, "erf": erf, "erfc": _erfc, "pow": pow, "hypot": hypot,
    **angle_functions(_quadrant, ATAN)}
