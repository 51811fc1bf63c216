"""Elementary functions of float32 by basic operations, without calls of the C library.

Each reduces its argument to a small interval and sums a polynomial there, of degree and coefficients such that the error of
the polynomial is below a quarter of a rounding (least squares at Chebyshev nodes, relative to the function;
`tests/jit/test_elementary.py` derives them anew). Errors in units in the last place against float64, over all of float32,
subnormals included, as that test measures them:

    exp 1.1    log 0.9    log1p 2.3    sin, cos 1.5 (tan 3.1) for |x| <= 2^15    atan2, atan 2.7    asin, acos 3.5
    erfc 4.0

Beyond 2^15 the absolute error of sin and cos is at most 2^-23 + 2^-52 |x|. Other functions go by float64 and the C library.

Reference: Muller 2016, "Elementary Functions: Algorithms and Implementation".
"""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
from torch import Tensor

from torch_radbp.jit.lane.angles import angle_functions, log_beyond_1, polynomial

LN2_HIGH, LN2_LOW = 0.693359375, -2.12194440e-4  # of ln 2: the first has few digits, so that its multiples are exact

# Coefficients of (exp(r) - 1 - r) / r^2, (log(1 + f) - f + f^2 / 2) / f^3, (sin(x) - x) / x^3, (cos(x) - 1 + x^2 / 2) / x^4
# and (atan(t) - t) / t^3; the last three are polynomials of the square. Then of exp(x^2) erfc(x) (1 + 2 x) for 0 <= x
# <= 10.1, a polynomial of (x - 2) / (x + 2).
EXP = (0.499999881, 0.166665182, 0.0416695327, 0.00836891588, 0.00137514074)
LOG = (0.333333105, -0.250000149, 0.200022042, -0.166676432, 0.142178908, -0.124112688, 0.11904712, -0.116464347,
       0.0667527169)
SIN = (-0.166666538, 0.00833214819, -0.000195139321)
COS = (0.0416666456, -0.00138872897, 2.44305738e-05)
ATAN = (-0.333333135, 0.199984238, -0.142427444, 0.105885722, -0.0606607124)
ERFC = (1.2769783735275269, -0.09276381880044937, -0.16603051126003265, 0.16405098140239716, -0.05421798676252365,
        -0.008030455559492111, 0.008710104040801525, 0.001251855748705566, -0.0014234299305826426, -0.0004008141113445163,
        0.00017178888083435595, 8.060235995799303e-05)

IN_LIBRARY = ("sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "exp", "exp2", "expm1", "log", "log2",
              "log10", "log1p", "erf", "erfc", "atan2", "hypot", "pow")


def in_double(function: Callable[..., Tensor], *arguments: Tensor | float) -> Tensor:
    """`function` of float32 arguments, evaluated in float64."""
    return function(*(argument.double() if isinstance(argument, Tensor) else argument for argument in arguments)).float()


def power_of_two(exponent: Tensor) -> Tensor:
    """2^exponent of int32 exponents from -126 to 127, by setting bits."""
    return ((exponent + 127) << 23).view(torch.float32)


def exp(x: Tensor) -> Tensor:
    x = x.clamp(-104.0, 89.0)  # zero and infinity beyond
    exponent = torch.round(x * (1 / math.log(2)))
    rest = (x - exponent * LN2_HIGH) - exponent * LN2_LOW
    return _scaled(exp_near_zero(rest), exponent)


def exp_near_zero(x: Tensor) -> Tensor:
    """exp(x) for |x| <= ln(2) / 2."""
    return 1.0 + (x + x * x * polynomial(x, EXP))


def _scaled(x: Tensor, exponent: Tensor) -> Tensor:
    """x 2^exponent for exponents that are whole numbers; also where the result is subnormal."""
    whole = exponent.to(torch.int32)
    half = whole >> 1
    return x * power_of_two(half) * power_of_two(whole - half)


def erfc(x: Tensor) -> Tensor:
    size = x.abs().clamp_max(10.1)  # zero beyond
    # exp(-x^2), whose argument is not rounded to float32: its relative error would be that of x^2, times x^2.
    square = size.double() * size.double()
    exponent = torch.round(square * (-1 / math.log(2)))
    rest = (-square - exponent * math.log(2)).float()
    tail = exp_near_zero(rest) * (polynomial((size - 2.0) / (size + 2.0), ERFC) / (1.0 + 2.0 * size))
    tail = _scaled(tail, exponent)
    return torch.where(x < 0, 2.0 - tail, tail)


def log(x: Tensor) -> Tensor:
    subnormal = x < 2.0**-126
    bits = torch.where(subnormal, x * 2.0**24, x).view(torch.int32)
    # The exponent for which the mantissa lies between sqrt(1/2) and sqrt(2).
    exponent = (bits - 0x3F3504F3) >> 23
    mantissa = (bits - (exponent << 23)).view(torch.float32)
    exponent = exponent.to(torch.float32) - torch.where(subnormal, 24.0, 0.0)
    f = mantissa - 1.0
    square = f * f
    result = exponent * LN2_HIGH + (f + (exponent * LN2_LOW + (square * f * polynomial(f, LOG) - 0.5 * square)))
    result = torch.where(x > 0, result, torch.where(x == 0, -math.inf, math.nan))
    return torch.where(x == math.inf, x, result)


def log1p(x: Tensor) -> Tensor:
    return log_beyond_1(x, log)


def quadrant(x: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """sin and cos of x reduced by a multiple of pi / 2, and the multiple modulo 4; the reduction is in float64."""
    turns = torch.round(x.double() * (2 / math.pi))
    rest = (x.double() - turns * (math.pi / 2)).float()
    square = rest * rest
    sine = rest + rest * square * polynomial(square, SIN)
    cosine = 1.0 - 0.5 * square + square * square * polynomial(square, COS)
    return sine, cosine, (turns - 4.0 * torch.floor(0.25 * turns)).float()


FORMULAS: dict[str, Callable[..., Tensor]] = {
    "exp": exp, "log": log, "log1p": log1p, "erfc": erfc, **angle_functions(quadrant, ATAN)}
