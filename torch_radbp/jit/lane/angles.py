"""Trigonometric functions, and log1p: formulas common to float32 and float64.

What depends on the precision is given: the reduction to a quadrant, the series of atan, the logarithm.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import torch
from torch import Tensor

Quadrant = tuple[Tensor, Tensor, Tensor]  # sin and cos of x less a multiple of pi / 2, and which multiple, modulo 4


def polynomial(x: Tensor, coefficients: Sequence[float]) -> Tensor:
    """Evaluates the polynomial with coefficients[k] of x^k."""
    total = torch.full_like(x, coefficients[-1])
    for coefficient in reversed(coefficients[:-1]):
        total = total * x + coefficient
    return total


def sine(x: Tensor, parts: Quadrant) -> Tensor:
    sine, cosine, quarter = parts
    value = torch.where((quarter == 1) | (quarter == 3), cosine, sine)
    return torch.where(x == 0, x, torch.where(quarter >= 2, -value, value))


def cosine(parts: Quadrant) -> Tensor:
    sine, cosine, quarter = parts
    value = torch.where((quarter == 1) | (quarter == 3), sine, cosine)
    return torch.where((quarter == 1) | (quarter == 2), -value, value)


def tangent(x: Tensor, parts: Quadrant) -> Tensor:
    sine, cosine, quarter = parts
    odd = (quarter == 1) | (quarter == 3)
    return torch.where(x == 0, x, torch.where(odd, -cosine, sine) / torch.where(odd, sine, cosine))


def _angle_of(y: Tensor, x: Tensor, series: Sequence[float]) -> Tensor:
    """atan2, by the series of (atan(t) - t) / t^3 in t^2 up to t = tan(pi / 8)."""
    ax, ay = x.abs(), y.abs()
    low, high = torch.minimum(ax, ay), torch.maximum(ax, ay)
    slope = torch.where(high == 0, 0.0, torch.where(low == math.inf, 1.0, low / high))
    steep = slope > math.tan(math.pi / 8)  # atan(t) = pi / 4 + atan((t - 1) / (t + 1))
    t = torch.where(steep, (slope - 1.0) / (slope + 1.0), slope)
    square = t * t
    angle = t + t * square * polynomial(square, series)
    angle = torch.where(steep, math.pi / 4 + angle, angle)
    angle = torch.where(ay > ax, math.pi / 2 - angle, angle)
    angle = torch.where(torch.copysign(torch.ones_like(x), x) < 0, math.pi - angle, angle)
    return torch.where((x != x) | (y != y), math.nan, torch.copysign(angle, y))


def angle_functions(quadrant: Callable[[Tensor], Quadrant], series: Sequence[float]) -> dict[str, Callable[..., Tensor]]:
    """The trigonometric functions of one precision, by name.

    Args:
        quadrant: reduces an angle.
        series: of `_angle_of`.
    """
    def atan2(y: Tensor, x: Tensor) -> Tensor:
        return _angle_of(y, x, series)

    def other_leg(x: Tensor) -> Tensor:
        return torch.sqrt((1.0 - x) * (1.0 + x))

    return {"sin": lambda x: sine(x, quadrant(x)), "cos": lambda x: cosine(quadrant(x)),
            "tan": lambda x: tangent(x, quadrant(x)), "atan2": atan2, "atan": lambda x: atan2(x, torch.ones_like(x)),
            "asin": lambda x: atan2(x, other_leg(x)), "acos": lambda x: atan2(other_leg(x), x)}


def log_beyond_1(x: Tensor, log: Callable[[Tensor], Tensor]) -> Tensor:
    """log1p by Kahan's formula: the rounding of 1 + x cancels."""
    rounded = 1.0 + x
    exact = rounded == 1.0
    result = log(rounded) * (x / torch.where(exact, 1.0, rounded - 1.0))
    return torch.where(exact | (x == math.inf), x, result)
