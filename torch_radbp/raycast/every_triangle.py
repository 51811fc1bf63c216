"""Tests of every triangle of a mesh against a vector of rays, as LLVM's text for any width and type of numbers.

The corners of the mesh are first seen along the rays: relative to the ray's origin, and sheared so that the ray runs along
its greatest axis at x = y = 0. Each corner is moved once for all of its triangles. The edge function x0 y1 - x1 y0 has its
exact sign, and so the opposite one in the triangle on its other side. A triangle is hit unless two of its edge functions
have opposite signs, so that no ray slips through an edge or a corner. Were it rounded to 0 where its products are close, a
triangle far smaller than its distance from the ray would be hit beside it.

Reference: Woop, Benthin and Wald 2013, "Watertight ray/triangle intersection".
"""

from __future__ import annotations

from typing import NamedTuple

from torch_radbp.raycast.queries import INFINITY, Kernel, Rays
from torch_radbp.raycast.vectors import ZERO, Vectors

# Numbers (V, 3) in units of the mesh, i32 (F, 3), and addresses of V and F, both i64, and of the length of 1 in those units.
INPUTS = ("corners", "triangles", "corner_count_at", "triangle_count_at", "scale_at")


class View(NamedTuple):
    """How a vector of rays sees points that are given relative to its origins."""

    o: list[str]  # the origins, in units of the mesh
    rows: list[list[str]]  # x, y, and the distance along the greatest axis of d
    unit: str  # length of d on that axis, in units of the mesh


def prepare(code: Vectors) -> None:
    """Lays what comes before the loop."""
    code.lay("%corner_count = load i64, ptr %corner_count_at", "%triangle_count = load i64, ptr %triangle_count_at",
             f"%scale = load {code.scalar}, ptr %scale_at",
             "%seen_count = mul i64 %corner_count, 3", f"%seen = alloca {code.numbers}, i64 %seen_count")


def view_along(code: Vectors, rays: Rays) -> View:
    """How rays see points: the greatest component of the direction is the axis along which they run."""
    d = rays.d
    x, y, z = (code.magnitude(component) for component in d)
    along_x = code.both(code.compare(x, "oge", y), code.compare(x, "oge", z))
    along_y = code.both(code.compare(y, "oge", z), code.neither(along_x, along_x))
    along_z = code.neither(along_x, along_y)
    greatest = code.choose(along_x, d[0], code.choose(along_y, d[1], d[2]))
    one = code.constant("1.0")
    ahead = code.choose(code.compare(greatest, "ogt", ZERO), one, code.constant("-1.0"))

    # Of the two other axes, take off what the ray goes along them.
    first = code.negative(code.div(code.choose(along_x, d[1], d[0]), greatest))
    second = code.negative(code.div(code.choose(along_z, d[1], d[2]), greatest))
    rows = [[code.choose(along_x, first, one), code.choose(along_x, one, code.choose(along_y, first, ZERO)),
             code.choose(along_z, first, ZERO)],
            [code.choose(along_x, second, ZERO), code.choose(along_y, second, code.choose(along_z, one, ZERO)),
             code.choose(along_z, second, one)],
            [code.choose(along, ahead, ZERO) for along in (along_x, along_y, along_z)]]

    scale = code.splat("%scale", code.scalar)
    o = [code.line(f"fmul {code.numbers} {component}, {scale}") for component in rays.o]
    return View(o, rows, code.mul(code.magnitude(greatest), scale))


def see_corners(code: Vectors, view: View) -> None:
    """Lays the loop that stores in `%seen` how rays see each corner, and then the head of the loop over triangles."""
    code.lay("br label %corner", "corner:", "%c = phi i64 [ 0, %cast ], [ %c.next, %corner ]")
    row = code.line("mul i64 %c, 3")
    place, target = code.at(code.scalar, "%corners", row), code.at(code.numbers, "%seen", row)
    away = [code.sub(code.splat(code.load(code.scalar, place, k), code.scalar), view.o[k]) for k in range(3)]
    for k, row in enumerate(view.rows):
        code.store(code.numbers, code.dot(row, away), code.at(code.numbers, target, k))
    code.lay("%c.next = add i64 %c, 1", "%c.more = icmp slt i64 %c.next, %corner_count",
             "br i1 %c.more, label %corner, label %ready", "ready:", "br label %triangle",
             "triangle:", "%k = phi i64 [ 0, %ready ], [ %k.next, %triangle ]")


def next_triangle(code: Vectors) -> None:
    """Lays the end of the loop over triangles, and then the label `found`."""
    code.lay("%k.next = add i64 %k, 1", "%k.more = icmp slt i64 %k.next, %triangle_count",
             "br i1 %k.more, label %triangle, label %found", "found:")


def seen_triangle(code: Vectors) -> list[list[str]]:
    """The three corners of the triangle `%k`, as rays see them."""
    row = code.at("i32", "%triangles", code.line("mul i64 %k, 3"))
    corners = []
    for number in range(3):
        corner = code.line(f"zext i32 {code.load('i32', row, number)} to i64")
        place = code.at(code.numbers, "%seen", code.line(f"mul i64 {corner}, 3"))
        corners.append([code.load(code.numbers, place, k) for k in range(3)])
    return corners


def crossing(code: Vectors, a: list[str], b: list[str], c: list[str]) -> tuple[list[str], str, str]:
    """The edge functions opposite to the corners, their sum, and the distance times that sum."""
    weights = [code.determinant(c, b), code.determinant(a, c), code.determinant(b, a)]
    total = code.add(code.add(weights[0], weights[1]), weights[2])
    return weights, total, code.dot(weights, [a[2], b[2], c[2]])


def inside(code: Vectors, weights: list[str]) -> str:
    """Flags of rays that pass through the triangle: no two weights have opposite signs."""
    low, high = weights[0], weights[0]
    for weight in weights[1:]:
        low = code.choose(code.compare(low, "olt", weight), low, weight)
        high = code.choose(code.compare(high, "ogt", weight), high, weight)
    return code.either(code.compare(low, "oge", ZERO), code.compare(high, "ole", ZERO))


def closest(code: Vectors, rays: Rays) -> tuple[str, str, str, str]:
    """prim, u, v and t of the closest hit; of several at one distance the first."""
    view = view_along(code, rays)
    farthest = code.choose(rays.valid, code.constant(INFINITY), ZERO)
    see_corners(code, view)
    code.lay(f"%best = phi {code.numbers} [ {farthest}, %ready ], [ %best.next, %triangle ]",
             f"%prim = phi {code.integers} [ splat (i32 -1), %ready ], [ %prim.next, %triangle ]")
    weights, total, distance = crossing(code, *seen_triangle(code))
    distance = code.rough_div(distance, total)
    closer = code.both(code.compare(distance, "ogt", ZERO), code.compare(distance, "olt", "%best"))
    hit = code.both(inside(code, weights), closer)
    number = code.splat(code.line("trunc i64 %k to i32"), "i32")
    code.lay(f"%best.next = select {code.flags} {hit}, {code.numbers} {distance}, {code.numbers} %best",
             f"%prim.next = select {code.flags} {hit}, {code.integers} {number}, {code.integers} %prim")
    next_triangle(code)

    # Say where that triangle is hit.
    found = code.line(f"icmp sge {code.integers} %prim.next, {ZERO}")
    row = code.line(f"mul {code.integers} {code.choose(found, '%prim.next', ZERO, 'i32')}, splat (i32 3)")
    corners = []
    for number in range(3):
        corner = code.gather("i32", "%triangles", code.line(f"add {code.integers} {row}, splat (i32 {number})"))
        place = code.line(f"mul {code.integers} {corner}, splat (i32 3)")
        places = [code.line(f"add {code.integers} {place}, splat (i32 {k})") for k in range(3)]
        away = [code.sub(code.gather(code.scalar, "%corners", places[k]), view.o[k]) for k in range(3)]
        corners.append([code.dot(row, away) for row in view.rows])
    weights, total, distance = crossing(code, *corners)
    u, v, t = code.div(weights[1], total), code.div(weights[2], total), code.div(code.div(distance, total), view.unit)
    return "%prim.next", *(code.choose(found, answer, ZERO) for answer in (u, v, t))


def occluded(code: Vectors, rays: Rays, tmax: str) -> str:
    """Flags of rays with a triangle at 0 < t <= tmax."""
    view = view_along(code, rays)
    end = code.choose(rays.valid, code.mul(tmax, view.unit), ZERO)
    see_corners(code, view)
    code.lay(f"%met = phi {code.flags} [ {ZERO}, %ready ], [ %met.next, %triangle ]")
    weights, total, distance = crossing(code, *seen_triangle(code))
    distance = code.negated_where_negative(distance, total)  # and so is what it is compared to: no division
    before_end = code.compare(distance, "ole", code.mul(end, code.magnitude(total)))
    hit = code.both(inside(code, weights), code.both(code.compare(distance, "ogt", ZERO), before_end))
    code.lay(f"%met.next = or {code.flags} %met, {hit}")
    next_triangle(code)
    return "%met.next"


KERNEL = Kernel(INPUTS, prepare, closest, occluded)
