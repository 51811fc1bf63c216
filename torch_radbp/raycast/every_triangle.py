"""Ray-triangle tests for a vector of rays, as LLVM IR for any width and floating-point type.

The corners of the mesh are first seen along the rays: relative to the ray's origin, and sheared so that the ray runs along
its greatest axis at x = y = 0. Each corner is moved once for all of its triangles. The edge function x0 y1 - x1 y0 has its
exact sign, and so the opposite one in the triangle on its other side. A triangle is hit unless two of its edge functions
have opposite signs, so that no ray slips through an edge or a corner. Were it rounded to 0 where its products are close, a
triangle far smaller than its distance from the ray would be hit beside it.

Reference: Woop, Benthin and Wald 2013, "Watertight ray/triangle intersection".
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from torch_radbp.raycast.queries import RayVector
from torch_radbp.raycast.vectors import ZERO, Vectors

ALONG_X, ALONG_Y, BACKWARDS = 1, 2, 4  # flags of `RayView.axis`


class RayView(NamedTuple):
    """A vector of rays, ready to transform points (in units of the mesh) into each ray's sheared coordinates."""

    o: list[str]  # the origins
    slopes: list[str]  # minus the ray's slopes along the two other axes, per unit of the main axis
    axis: str  # i32, flags: the main axis of each ray, the greatest component of its direction

    @classmethod
    def of(cls, numbers: Iterable[str]) -> RayView:
        """Makes the view from the names of its six LLVM values, one after the other."""
        x, y, z, first, second, axis = numbers
        return cls([x, y, z], [first, second], axis)

    def sees(self, code: Vectors, p: list[str]) -> list[str]:
        """Transforms points into the rays' sheared coordinates: x, y and the distance along the main axis."""
        away = [code.sub(number, origin) for number, origin in zip(p, self.o)]
        along_x, along_y = (flagged(code, self.axis, flag) for flag in (ALONG_X, ALONG_Y))
        along = code.choose(along_x, away[0], code.choose(along_y, away[1], away[2]))
        first, second = code.choose(along_x, away[1], away[0]), code.choose(code.either(along_x, along_y), away[2], away[1])
        backwards = flagged(code, self.axis, BACKWARDS)
        return [code.fused(self.slopes[0], along, first), code.fused(self.slopes[1], along, second),
                code.choose(backwards, code.negative(along), along)]


def flagged(code: Vectors, integers: str, flag: int) -> str:
    """Flags of lanes whose integer has the bit `flag` set."""
    return code.line(f"icmp ne {code.integers} {code.line(f'and {code.integers} {integers}, splat (i32 {flag})')}, {ZERO}")


def view_along(code: Vectors, rays: RayVector) -> tuple[RayView, str]:
    """The view of points along rays, and the length of 1 along the main axis in units of the mesh."""
    d = rays.d
    x, y, z = (code.magnitude(component) for component in d)
    along_x = code.both(code.compare(x, "oge", y), code.compare(x, "oge", z))
    along_y = code.both(code.compare(y, "oge", z), code.neither(along_x, along_x))
    along_z = code.neither(along_x, along_y)
    greatest = code.choose(along_x, d[0], code.choose(along_y, d[1], d[2]))
    slopes = [code.negative(code.div(code.choose(along_x, d[1], d[0]), greatest)),
              code.negative(code.div(code.choose(along_z, d[1], d[2]), greatest))]
    axis = code.choose(along_x, f"splat (i32 {ALONG_X})", code.choose(along_y, f"splat (i32 {ALONG_Y})", ZERO, "i32"), "i32")
    turned = code.line(f"or {code.integers} {axis}, splat (i32 {BACKWARDS})")
    axis = code.choose(code.compare(greatest, "ogt", ZERO), axis, turned, "i32")
    scale = code.splat("%scale", code.scalar)
    o = [code.line(f"fmul {code.numbers} {component}, {scale}") for component in rays.o]
    return RayView(o, slopes, axis), code.mul(code.magnitude(greatest), scale)


class Crossing(NamedTuple):
    """The crossings of rays with the plane of a face, by edge functions and a distance."""

    edges: list[str]  # the edge functions: on which side of each edge
    total: str  # twice the area of the triangle, as rays see it
    distance: str  # along the main axis, times `total`


def triangle_crossing(code: Vectors, a: list[str], b: list[str], c: list[str]) -> Crossing:
    """The crossing of rays with the plane of a triangle; each edge function is of the edge opposite to a corner."""
    edges = [code.determinant(c, b), code.determinant(a, c), code.determinant(b, a)]
    total = code.add(code.add(edges[0], edges[1]), edges[2])
    return Crossing(edges, total, code.dot(edges, [a[2], b[2], c[2]]))


def crossing_of_both(code: Vectors, a: list[str], b: list[str], c: list[str], d: list[str]) -> tuple[Crossing, str]:
    """The crossing with a parallelogram of the triangles a, b, c and a, c, d, and the edge function of the diagonal."""
    half = triangle_crossing(code, a, b, c)
    return half._replace(edges=[half.edges[0], half.edges[2], code.determinant(d, c), code.determinant(a, d)]), half.edges[1]


def _inside(code: Vectors, edges: list[str]) -> str:
    """Flags of rays that pass through a face: no two edge functions have opposite signs."""
    low, high = edges[0], edges[0]
    for edge in edges[1:]:
        low, high = code.lesser(low, edge), code.greater(high, edge)
    return code.either(code.compare(low, "oge", ZERO), code.compare(high, "ole", ZERO))


def closer(code: Vectors, crossing: Crossing, end: str) -> tuple[str, str]:
    """Flags of rays that cross a face before `end`, and t of the crossing."""
    distance = code.div(crossing.distance, crossing.total)
    before_end = code.both(code.compare(distance, "ogt", ZERO), code.compare(distance, "olt", end))
    return code.both(_inside(code, crossing.edges), before_end), distance


def struck(code: Vectors, crossing: Crossing, end: str) -> str:
    """Flags of rays that cross a face at or before `end`."""
    distance = code.negated_where_negative(crossing.distance, crossing.total)  # so is what it is compared to: no division
    before_end = code.compare(distance, "ole", code.mul(end, code.magnitude(crossing.total)))
    return code.both(_inside(code, crossing.edges), code.both(code.compare(distance, "ogt", ZERO), before_end))


def place_on(code: Vectors, corners: list[list[str]], unit: str) -> tuple[str, str, str]:
    """Barycentric u and v, and t, of hits on triangles; `unit`: the length of 1 along the rays."""
    weights, total, distance = triangle_crossing(code, *corners)
    return code.div(weights[1], total), code.div(weights[2], total), code.div(code.div(distance, total), unit)
