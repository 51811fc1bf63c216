"""Tests of every ball against a vector of rays, beside what another kernel does with the other triangles, as LLVM's text.

For a point p, relative to the unit sphere, let n be the normal of the facet that the line from the centre through p meets,
scaled so that n . x = 1 in the facet's plane. Then n . p is a convex function of p, which is 1 on the ball's surface (its
gauge). Along a ray it is convex, too, and made of straight pieces: Newton's method, started where the ray meets the sphere
or at its origin if that is outside, reaches the entry from one facet to the next and never passes it. If the function stops
falling the ray misses the ball. From the sphere's far side it reaches the exit in the same way. Most rays take two steps.

A ray that starts within `NEAR` of the sphere starts inside if n . p <= 1 there, so that one that leaves the surface is as
sure to get away as rays that leave triangles are.

Reference: Rockafellar 1970, "Convex Analysis", section 15, for gauges.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from torch_radbp.raycast.queries import INFINITY, Kernel, Rays
from torch_radbp.raycast.vectors import ZERO, Vectors
from torch_radbp.shape.ball import RINGS, SEGMENTS, TRIANGLES

# As `ball.Tables`, and the numbers of the other triangles in the mesh.
INPUTS = ("placements", "ball_triangles", "ball_count_at", "sectors", "rings", "numbers")
NEAR = 2.0**-10  # by how much the square of the distance from the centre may exceed 1
STEPS = 12  # rays that graze a ball may turn in circles, by rounding
TINY = 1e-30
# The arc tangent on [0, 1] within 1e-7: coefficients of odd powers, a fit of ours.
ARC = (0.999999886, -0.33332597, 0.199859068, -0.141612294, 0.104989467, -0.0723485825, 0.0397812309, -0.0144013611,
       0.00245672513)


class Facet(NamedTuple):
    """The facets in the direction of points from the centre."""

    row: str  # i32, of polar angles
    column: str  # i32, of azimuths
    middle: list[str]  # cosine and sine of the azimuth of its middle
    n: list[str]  # n . x = 1 in its plane


class Local(NamedTuple):
    """A vector of rays relative to one ball: the unit sphere at the origin."""

    o: list[str]
    d: list[str]

    def at(self, code: Vectors, t: str) -> list[str]:
        """The points at distances `t`."""
        return [code.add(o, code.mul(d, t)) for o, d in zip(self.o, self.d)]


def beside(kernel: Kernel) -> Kernel:
    """A kernel for balls and for the other triangles, which `kernel` sees under numbers of their own."""

    def closest(code: Vectors, rays: Rays) -> tuple[str, str, str, str]:
        prim, u, v, t = kernel.closest(code, rays)
        found = code.line(f"icmp sge {code.integers} {prim}, {ZERO}")
        prim = code.choose(found, code.gather("i32", "%numbers", prim, found), prim, "i32")
        farthest = code.choose(found, t, code.choose(rays.valid, code.constant(INFINITY), ZERO))
        return closest_ball(code, rays, (farthest, prim, u, v))

    def occluded(code: Vectors, rays: Rays, tmax: str) -> str:
        met = kernel.occluded(code, rays, tmax)
        return any_ball(code, rays, met, code.choose(rays.valid, tmax, ZERO))

    def prepare(code: Vectors) -> None:
        kernel.prepare(code)
        code.lay("%ball_count = load i64, ptr %ball_count_at")

    return Kernel((*kernel.inputs, *INPUTS), prepare, closest, occluded)


def closest_ball(code: Vectors, rays: Rays, before: tuple[str, str, str, str]) -> tuple[str, str, str, str]:
    """prim, u, v and t of the closest hit of balls, or of what was found before: t, which bounds the search, prim, u, v."""
    kinds = (code.numbers, code.integers, code.numbers, code.numbers)
    names = ("ball.t", "ball.prim", "ball.u", "ball.v")
    code.lay("br label %balls", "balls:", "br label %ball",
             "ball:", "%b = phi i64 [ 0, %balls ], [ %b.next, %next_ball ]",
             *(f"%{name} = phi {kind} [ {first}, %balls ], [ %{name}.next, %next_ball ]"
               for name, kind, first in zip(names, kinds, before)))
    local, hit, t, facet = meet_ball(code, rays, "%ball.t")
    prim, u, v = place_on_facet(code, local.at(code, t), facet)
    known = zip(names, ("float", "i32", "float", "float"), (t, prim, u, v))
    chosen = [(name, code.choose(hit, new, f"%{name}", "i32" if kind == "i32" else "")) for name, kind, new in known]
    code.lay("br label %next_ball", "next_ball:",
             *(f"%{name}.next = phi {kind} [ %{name}, %ball ], [ {new}, %settled ]"
               for (name, new), kind in zip(chosen, kinds)))
    next_ball(code)
    found = code.line(f"icmp sge {code.integers} %ball.prim.next, {ZERO}")
    return ("%ball.prim.next", "%ball.u.next", "%ball.v.next", code.choose(found, "%ball.t.next", ZERO))


def any_ball(code: Vectors, rays: Rays, before: str, tmax: str) -> str:
    """Flags of rays that were met before, or meet a ball at 0 < t <= tmax."""
    code.lay("br label %balls", "balls:")
    left = code.choose(before, ZERO, tmax)
    code.lay("br label %ball", "ball:", "%b = phi i64 [ 0, %balls ], [ %b.next, %next_ball ]",
             f"%left = phi {code.numbers} [ {left}, %balls ], [ %left.next, %next_ball ]")
    _, hit, _, _ = meet_ball(code, rays, "%left")
    rest = code.choose(hit, ZERO, "%left")
    code.lay("br label %next_ball", "next_ball:",
             f"%left.next = phi {code.numbers} [ %left, %ball ], [ {rest}, %settled ]")
    next_ball(code)
    return code.either(before, code.both(code.compare("%left.next", "oeq", ZERO), code.compare(tmax, "ogt", ZERO)))


def next_ball(code: Vectors) -> None:
    """Lays the end of the loop over balls."""
    code.lay("%b.next = add i64 %b, 1", "%b.more = icmp slt i64 %b.next, %ball_count",
             "br i1 %b.more, label %ball, label %all_balls", "all_balls:")


def meet_ball(code: Vectors, rays: Rays, end: str) -> tuple[Local, str, str, Facet]:
    """Lays the meeting with the ball `%b`; from the label `ball` to `next_ball` if no ray comes near, else to `settled`.

    Returns:
        The rays; flags of those that hit at 0 < t <= `end`; t, and the facet that is hit.
    """
    place = code.at(code.scalar, "%placements", code.line("mul i64 %b, 12"))
    values = [code.splat(code.load(code.scalar, place, number), code.scalar) for number in range(12)]
    rows = [values[3:6], values[6:9], values[9:12]]
    away = [code.sub(o, centre) for o, centre in zip(rays.o, values)]
    local = Local([code.dot(row, away) for row in rows], [code.dot(row, rays.d) for row in rows])
    o, d = local

    # Where rays enter and leave the sphere: half a chord from the point closest to its centre.
    one = code.constant("1.0")
    squared = code.dot(d, d)
    middle = code.negative(code.div(code.dot(o, d), squared))
    nearest = local.at(code, middle)
    inside = code.sub(one, code.dot(nearest, nearest))
    half = square_root(code, code.div(code.choose(code.compare(inside, "ogt", ZERO), inside, ZERO), squared))
    enter, leave = code.sub(middle, half), code.add(middle, half)
    near = code.compare(code.dot(o, o), "ole", code.number(1 + NEAR))
    start = code.choose(near, ZERO, enter)
    ahead = code.both(code.compare(leave, "ogt", ZERO), code.compare(start, "ole", end))
    meets = code.both(code.both(rays.valid, code.compare(inside, "ogt", ZERO)),
                      code.both(ahead, code.either(near, code.compare(start, "ogt", ZERO))))
    meets = code.both(meets, code.compare(end, "ogt", ZERO))
    branch_if_any(code, meets, "meet", "next_ball")

    # Rays that start inside look for the exit, from the other side.
    facet = facet_of(code, local.at(code, start), meets)
    out = code.both(near, code.compare(code.dot(facet.n, o), "ole", one))
    begin = code.choose(out, leave, start)
    code.lay("br label %step", "step:", f"%reached = phi {code.numbers} [ {begin}, %meet ], [ %further, %step ]",
             f"%row = phi {code.integers} [ splat (i32 -1), %meet ], [ %row.next, %step ]",
             f"%column = phi {code.integers} [ splat (i32 -1), %meet ], [ %column.next, %step ]",
             f"%meeting = phi {code.flags} [ {meets}, %meet ], [ %meeting.next, %step ]",
             "%steps = phi i64 [ 1, %meet ], [ %steps.next, %step ]")
    facet = facet_of(code, local.at(code, "%reached"), "%meeting")
    slope = code.dot(facet.n, d)
    falls = code.compare(code.choose(out, code.negative(slope), slope), "olt", ZERO)
    same = code.both(code.line(f"icmp eq {code.integers} {facet.row}, %row"),
                     code.line(f"icmp eq {code.integers} {facet.column}, %column"))
    crossing = code.div(code.sub(one, code.dot(facet.n, o)), slope)
    code.lay(f"%row.next = add {code.integers} {facet.row}, {ZERO}",
             f"%column.next = add {code.integers} {facet.column}, {ZERO}",
             f"%meeting.next = and {code.flags} %meeting, {falls}",
             f"%further = select {code.flags} {same}, {code.numbers} %reached, {code.numbers} {crossing}",
             "%steps.next = add i64 %steps, 1")
    moving = code.both("%meeting.next", code.line(f"xor {code.flags} {same}, splat (i1 true)"))
    some = code.line(f"icmp ne i64 {code.bits(moving)}, 0")
    again = code.line(f"and i1 {some}, {code.line(f'icmp slt i64 %steps, {STEPS}')}")
    code.lay(f"br i1 {again}, label %step, label %settled", "settled:")
    hit = code.both(code.compare("%further", "ogt", ZERO), code.compare("%further", "ole", end))
    return local, code.both("%meeting.next", hit), "%further", facet


def branch_if_any(code: Vectors, flags: str, to: str, otherwise: str) -> None:
    """Goes to a label, which follows, if any flag is set."""
    code.lay(f"br i1 {code.line(f'icmp ne i64 {code.bits(flags)}, 0')}, label %{to}, label %{otherwise}", f"{to}:")


def facet_of(code: Vectors, p: list[str], mask: str) -> Facet:
    """The facets that lines from the centre through points meet."""
    azimuth = angle(code, p[0], p[1])
    whole = code.sub(code.number(2 * math.pi), azimuth)
    azimuth = code.choose(code.compare(p[1], "olt", ZERO), whole, azimuth)
    column = cell(code, azimuth, SEGMENTS / (2 * math.pi), SEGMENTS, mask)
    place = code.line(f"mul {code.integers} {column}, splat (i32 2)")
    middle = [code.gather(code.scalar, "%sectors", plus(code, place, number), mask) for number in range(2)]

    # The edge between two rows is a chord, which is nearer to the axis in its middle than at its ends.
    r = code.add(code.mul(p[0], middle[0]), code.mul(p[1], middle[1]))
    polar = angle(code, p[2], code.mul(r, code.number(1 / math.cos(math.pi / SEGMENTS))))
    row = cell(code, polar, RINGS / math.pi, RINGS, mask)
    place = code.line(f"mul {code.integers} {row}, splat (i32 7)")
    outwards, up = (code.gather(code.scalar, "%rings", plus(code, place, number), mask) for number in range(2))
    return Facet(row, column, middle, [code.mul(outwards, middle[0]), code.mul(outwards, middle[1]), up])


def angle(code: Vectors, x: str, y: str) -> str:
    """The angle in [0, pi] between the x axis and (x, |y|)."""
    wide, high = code.magnitude(x), code.magnitude(y)
    steep = code.compare(high, "ogt", wide)
    least, most = code.choose(steep, wide, high), code.choose(steep, high, wide)
    ratio = code.rough_div(least, code.add(most, code.number(TINY)))
    square, sum_ = code.mul(ratio, ratio), code.number(ARC[-1])
    for coefficient in reversed(ARC[:-1]):
        sum_ = code.add(code.mul(sum_, square), code.number(coefficient))
    arc = code.mul(sum_, ratio)
    arc = code.choose(steep, code.sub(code.number(math.pi / 2), arc), arc)
    return code.choose(code.compare(x, "olt", ZERO), code.sub(code.number(math.pi), arc), arc)


def cell(code: Vectors, angle: str, per_radian: float, count: int, mask: str) -> str:
    """The number of the cell with an angle, i32 in [0, count); 0 where the mask is not set."""
    scaled = code.choose(mask, code.mul(angle, code.number(per_radian)), ZERO)
    whole = code.call(f"llvm.fptosi.sat.{code.suffix('i32')}.{code.suffix(code.scalar)}", code.integers,
                      (code.numbers, scaled))
    return code.call(f"llvm.smin.{code.suffix('i32')}", code.integers, (code.integers, whole),
                     (code.integers, f"splat (i32 {count - 1})"))


def plus(code: Vectors, integers: str, number: int) -> str:
    return code.line(f"add {code.integers} {integers}, splat (i32 {number})")


def square_root(code: Vectors, a: str) -> str:
    return code.call(f"llvm.sqrt.{code.suffix(code.scalar)}", code.numbers, (code.numbers, a))


def place_on_facet(code: Vectors, p: list[str], facet: Facet) -> tuple[str, str, str]:
    """prim, u and v of points on facets of the ball `%b`."""
    place = code.line(f"mul {code.integers} {facet.row}, splat (i32 7)")
    of_r, of_z, constant, w0, w1 = (code.gather(code.scalar, "%rings", plus(code, place, number)) for number in range(2, 7))
    (cosine, sine), (x, y, z) = facet.middle, p
    r = code.add(code.mul(x, cosine), code.mul(y, sine))
    aside = code.sub(code.mul(y, cosine), code.mul(x, sine))
    height = code.add(code.add(code.mul(of_r, r), code.mul(of_z, z)), constant)

    # The diagonal runs from -w0 at height 0 to w1 at height 1; a row at a pole has only one half.
    beyond = code.add(aside, code.sub(w0, code.mul(height, code.add(w0, w1))))
    lesser = code.both(code.compare(beyond, "oge", ZERO), code.line(f"icmp ne {code.integers} {facet.row}, {ZERO}"))
    lesser = code.either(lesser, code.line(f"icmp eq {code.integers} {facet.row}, splat (i32 {RINGS - 1})"))
    width = code.choose(lesser, w0, w1)
    share = code.rough_div(beyond, code.add(width, width))
    # Corners of the lesser half: both angles least, both greatest, and the third; of the other: least, third, greatest.
    v = code.choose(lesser, share, code.add(share, height))
    u = code.choose(lesser, height, code.negative(share))

    at = code.at("i32", "%ball_triangles", code.line("mul i64 %b, 2"))
    first, turned = (code.splat(code.load("i32", at, number), "i32") for number in range(2))
    turned = code.line(f"icmp ne {code.integers} {turned}, {ZERO}")
    u, v = code.choose(turned, v, u), code.choose(turned, u, v)
    number = code.line(f"add {code.integers} {facet.column}, "
                       f"{code.line(f'mul {code.integers} {facet.row}, splat (i32 {SEGMENTS})')}")
    shift = code.choose(lesser, f"splat (i32 {-SEGMENTS})", f"splat (i32 {TRIANGLES // 2})", "i32")
    return code.line(f"add {code.integers} {first}, {code.line(f'add {code.integers} {number}, {shift}')}"), u, v
