"""The facets of a tessellated sphere that lines from its centre meet, as LLVM IR; see `interface.balls`."""

from __future__ import annotations

import math
from typing import NamedTuple

from torch_radbp.interface.balls import RINGS, SEGMENTS, TRIANGLES
from torch_radbp.raycast.vectors import ZERO, Vectors

TINY = 1e-30
# The arc tangent on [0, 1] within 1e-7: coefficients of odd powers, a fit of ours.
ARC = (0.999999886, -0.33332597, 0.199859068, -0.141612294, 0.104989467, -0.0723485825, 0.0397812309, -0.0144013611,
       0.00245672513)


class Facet(NamedTuple):
    """The facets of a unit sphere's tessellation that lie in given directions from the centre."""

    row: str  # i32, by polar angle
    column: str  # i32, by azimuth
    n: list[str]  # the plane n . x = 1 of the facet


def facet_of(code: Vectors, p: list[str], mask: str) -> Facet:
    """The facets that lines from the centre through points `p` meet."""
    azimuth = angle(code, p[0], p[1])
    whole = code.sub(code.number(2 * math.pi), azimuth)
    azimuth = code.choose(code.compare(p[1], "olt", ZERO), whole, azimuth)
    column = cell(code, azimuth, SEGMENTS / (2 * math.pi), SEGMENTS, mask)
    middle = middle_of(code, column, mask)

    # The edge between two rows is a chord, which is nearer to the axis in its middle than at its ends.
    r = code.add(code.mul(p[0], middle[0]), code.mul(p[1], middle[1]))
    polar = angle(code, p[2], code.mul(r, code.number(1 / math.cos(math.pi / SEGMENTS))))
    row = cell(code, polar, RINGS / math.pi, RINGS, mask)
    place = code.line(f"mul {code.integers} {row}, splat (i32 7)")
    outwards, up = (code.gather(code.scalar, "%rings", plus(code, place, number), mask) for number in range(2))
    return Facet(row, column, [code.mul(outwards, middle[0]), code.mul(outwards, middle[1]), up])


def middle_of(code: Vectors, column: str, mask: str) -> list[str]:
    """Cosine and sine of the azimuth in the middle of columns of facets."""
    place = code.line(f"mul {code.integers} {column}, splat (i32 2)")
    return [code.gather(code.scalar, "%sectors", plus(code, place, number), mask) for number in range(2)]


def angle(code: Vectors, x: str, y: str) -> str:
    """The angle in [0, pi] between the x axis and (x, |y|)."""
    wide, high = code.magnitude(x), code.magnitude(y)
    steep = code.compare(high, "ogt", wide)
    least, most = code.choose(steep, wide, high), code.choose(steep, high, wide)
    ratio = code.div(least, code.add(most, code.number(TINY)))
    square = code.mul(ratio, ratio)
    fourth = code.mul(square, square)
    even, odd = (_polynomial(code, ARC[first::2], fourth) for first in (0, 1))  # side by side: neither waits for the other
    arc = code.mul(code.add(code.mul(odd, square), even), ratio)
    arc = code.choose(steep, code.sub(code.number(math.pi / 2), arc), arc)
    return code.choose(code.compare(x, "olt", ZERO), code.sub(code.number(math.pi), arc), arc)


def _polynomial(code: Vectors, coefficients: tuple[float, ...], x: str) -> str:
    """Evaluates a polynomial in `x`, with coefficients from the constant upwards."""
    value = code.number(coefficients[-1])
    for coefficient in reversed(coefficients[:-1]):
        value = code.add(code.mul(value, x), code.number(coefficient))
    return value


def cell(code: Vectors, angle: str, per_radian: float, count: int, mask: str) -> str:
    """The index of the cell of an angle, i32 in [0, count); 0 where the mask is not set."""
    scaled = code.choose(mask, code.mul(angle, code.number(per_radian)), ZERO)
    # Of a float that is too great, or none, a processor would have to ask lane by lane.
    return code.line(f"fptosi {code.numbers} {code.lesser(scaled, code.number(count - 1))} to {code.integers}")


def plus(code: Vectors, integers: str, number: int) -> str:
    return code.line(f"add {code.integers} {integers}, splat (i32 {number})")


def place_on_facet(code: Vectors, p: list[str], ball: str, row: str, column: str) -> tuple[str, str, str]:
    """prim, u and v of points on facets of balls.

    Args:
        p: the points, relative to the unit sphere.
        ball, row, column: i32, which ball and which of its facets.
    """
    cosine, sine = middle_of(code, column, "splat (i1 true)")
    place, (x, y, z) = code.line(f"mul {code.integers} {row}, splat (i32 7)"), p
    of_r, of_z, constant, w0, w1 = (code.gather(code.scalar, "%rings", plus(code, place, number)) for number in range(2, 7))
    r = code.add(code.mul(x, cosine), code.mul(y, sine))
    aside = code.sub(code.mul(y, cosine), code.mul(x, sine))
    height = code.add(code.add(code.mul(of_r, r), code.mul(of_z, z)), constant)

    # The diagonal runs from -w0 at height 0 to w1 at height 1; a row at a pole has only one half.
    beyond = code.add(aside, code.sub(w0, code.mul(height, code.add(w0, w1))))
    lesser = code.both(code.compare(beyond, "oge", ZERO), code.line(f"icmp ne {code.integers} {row}, {ZERO}"))
    lesser = code.either(lesser, code.line(f"icmp eq {code.integers} {row}, splat (i32 {RINGS - 1})"))
    width = code.choose(lesser, w0, w1)
    share = code.div(beyond, code.add(width, width))
    # Corners of the lesser half: both angles least, both greatest, and the third; of the other: least, third, greatest.
    v = code.choose(lesser, share, code.add(share, height))
    u = code.choose(lesser, height, code.negative(share))

    at = code.line(f"mul {code.integers} {ball}, splat (i32 2)")
    first, turned = (code.gather("i32", "%ball_triangles", plus(code, at, number)) for number in range(2))
    turned = code.line(f"icmp ne {code.integers} {turned}, {ZERO}")
    u, v = code.choose(turned, v, u), code.choose(turned, u, v)
    number = code.line(f"add {code.integers} {column}, "
                       f"{code.line(f'mul {code.integers} {row}, splat (i32 {SEGMENTS})')}")
    shift = code.choose(lesser, f"splat (i32 {-SEGMENTS})", f"splat (i32 {TRIANGLES // 2})", "i32")
    return code.line(f"add {code.integers} {first}, {code.line(f'add {code.integers} {number}, {shift}')}"), u, v
