"""Intersections of vectors of rays with tessellated spheres, added to another kernel for the other triangles, as LLVM IR.

Every ray is tested against the spheres around all balls. Then each meets the ball of the nearest sphere, whichever that is,
until it hits a ball before the next sphere.

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

from typing import NamedTuple

from torch_radbp.raycast.facet import Facet, facet_of, place_on_facet, plus
from torch_radbp.raycast.queries import INFINITY, CasterKernel, RayVector
from torch_radbp.raycast.vectors import ZERO, Vectors

# As `ball.BallTables`, and the numbers of the other triangles in the mesh.
INPUTS = ("placements", "ball_triangles", "ball_count_at", "sectors", "rings", "numbers")
NEAR = 2.0**-10  # by how much the square of the distance from the centre may exceed 1
STEPS = 12  # rays that graze a ball may turn in circles, by rounding


class Local(NamedTuple):
    """A vector of rays in the frame of one ball, where its sphere is the unit sphere at the origin."""

    o: list[str]
    d: list[str]

    def at(self, code: Vectors, t: str) -> list[str]:
        """The points on the rays at distances `t`."""
        return [code.add(o, code.mul(d, t)) for o, d in zip(self.o, self.d)]


class SphereCrossing(NamedTuple):
    """Where rays enter and leave the sphere around a ball."""

    start: str  # t at which the search for the facet starts: where the ray enters, or 0 if its origin is near
    leave: str  # t at which the ray leaves
    near: str  # flags: the origin is inside the sphere, or near
    met: str  # flags: the sphere lies ahead


class Nearest(NamedTuple):
    """The next ball along each ray, and whether there is one."""

    number: str  # i32, of the ball; 0 where there is none
    some: str  # flags: there is one


def beside(kernel: CasterKernel) -> CasterKernel:
    """A kernel that casts rays against balls and, by `kernel`, against the triangles that belong to no ball, which `kernel`
    numbers by themselves.
    """

    def closest(code: Vectors, rays: RayVector) -> tuple[str, ...]:
        prim, u, v, t, *instance = kernel.closest(code, rays)
        is_hit, prim = code.line(f"icmp sge {code.integers} {prim}, {ZERO}"), numbers_in_mesh(code, prim)
        farthest = code.choose(is_hit, t, code.choose(rays.valid, code.constant(INFINITY), ZERO))
        answer = closest_ball(code, rays, (farthest, prim, u, v))
        kept = code.line(f"icmp eq {code.integers} {prim}, {answer[0]}")  # balls are in no group
        return *answer, *(code.choose(kept, shown, ZERO, "i32") for shown in instance)

    def occluded(code: Vectors, rays: RayVector, tmax: str) -> str:
        met = kernel.occluded(code, rays, tmax)
        return any_ball(code, rays, met, code.choose(rays.valid, tmax, ZERO))

    def prepare_both(code: Vectors) -> None:
        kernel.prepare(code)
        prepare(code)

    return CasterKernel((*kernel.inputs, *INPUTS), prepare_both, closest, occluded, kernel.instances)


def prepare(code: Vectors) -> None:
    """Emits, before the loop over lanes, the loading of the number of balls, and room for one distance for each."""
    code.lay("%ball_count = load i64, ptr %ball_count_at", f"%starts = alloca {code.numbers}, i64 %ball_count")


def numbers_in_mesh(code: Vectors, prim: str) -> str:
    """Maps the numbers of triangles that are no ball's to their numbers in the mesh; -1 (a miss) stays."""
    is_hit = code.line(f"icmp sge {code.integers} {prim}, {ZERO}")
    return code.choose(is_hit, code.gather("i32", "%numbers", prim, is_hit), prim, "i32")


def closest_ball(code: Vectors, rays: RayVector, before: tuple[str, str, str, str]) -> tuple[str, str, str, str]:
    """prim, u, v and t of the closest hit among balls and the hit `before`, whose t, prim, u and v are given."""
    farthest, *others = before
    carried = [("ball.t", code.numbers, farthest),
               *((f"ball.{name}", code.integers, "splat (i32 -1)") for name in ("met", "row", "column"))]
    begin_search(code, rays, carried)
    hit, t, facet = meet_nearest(code, rays, next_ball(code, "%ball.t"), "%ball.t")
    for (name, kind, _), new in zip(carried, (t, "%near.ball.next", facet.row, facet.column)):
        code.lay(f"%{name}.next = select {code.flags} {hit}, {kind} {new}, {kind} %{name}")
    code.lay("br label %search", "all_balls:")
    return placed(code, rays, ("%ball.met", "%ball.row", "%ball.column"), "%ball.t", others, "all_balls")


def placed(code: Vectors, rays: RayVector, met: tuple[str, str, str], t: str, others: list[str], before: str
           ) -> tuple[str, str, str, str]:
    """prim, u, v and t of rays that hit a facet of a ball, or another triangle, at distance `t`.

    Args:
        met: i32, the ball, negative where it is none, and row and column of its facet.
        others: prim, u and v of what is no ball.
        before: the label of this block.
    """
    ball, row, column = met
    on_ball = code.line(f"icmp sge {code.integers} {ball}, {ZERO}")
    branch_if_any(code, on_ball, "place", "placed")
    ball, row, column = (code.choose(on_ball, number, ZERO, "i32") for number in (ball, row, column))
    answers = place_on_facet(code, local_of(code, rays, Nearest(ball, on_ball)).at(code, t), ball, row, column)
    kinds = ("i32", code.scalar, code.scalar)
    answers = [code.choose(on_ball, *values, kind) for *values, kind in zip(answers, others, kinds)]
    code.lay("br label %placed", "placed:")
    prim, u, v = (code.line(f"phi {code.vector(kind)} [ {old}, %{before} ], [ {new}, %place ]")
                  for old, new, kind in zip(others, answers, kinds))
    return prim, u, v, code.choose(code.line(f"icmp sge {code.integers} {prim}, {ZERO}"), t, ZERO)


def any_ball(code: Vectors, rays: RayVector, before: str, tmax: str) -> str:
    """Flags of rays that are set in `before`, or whose ray hits a ball at 0 < t <= tmax."""
    begin_search(code, rays, [("left", code.numbers, code.choose(before, ZERO, tmax))])
    hit, _, _ = meet_nearest(code, rays, next_ball(code, "%left"), "%left")
    code.lay(f"%left.next = select {code.flags} {hit}, {code.numbers} {ZERO}, {code.numbers} %left",
             "br label %search", "all_balls:")
    return code.either(before, code.both(code.compare("%left", "oeq", ZERO), code.compare(tmax, "ogt", ZERO)))


def begin_search(code: Vectors, rays: RayVector, carried: list[tuple[str, str, str]]) -> None:
    """Emits a loop that stores in `%starts` where rays enter each sphere, and the head of the loop that visits spheres in
    that order.

    Args:
        carried: name, type and first value of each variable of the loop.
    """
    code.lay("br label %balls", "balls:", "br label %sphere",
             "sphere:", "%s = phi i64 [ 0, %balls ], [ %s.next, %sphere ]")
    place = code.at(code.scalar, "%placements", code.line("mul i64 %s, 12"))
    sphere = meet_sphere(code, seen_from_ball(code, rays, [code.splat(code.load(code.scalar, place, number), code.scalar)
                                                           for number in range(12)]))
    start = code.choose(code.both(rays.valid, sphere.met), sphere.start, code.constant(INFINITY))
    code.store(code.numbers, start, code.at(code.numbers, "%starts", "%s"))
    code.lay("%s.next = add i64 %s, 1", "%s.more = icmp slt i64 %s.next, %ball_count",
             "br i1 %s.more, label %sphere, label %spheres", "spheres:", "br label %search",
             "search:", *(f"%{name} = phi {kind} [ {first}, %spheres ], [ %{name}.next, %settled ]"
                          for name, kind, first in carried),
             f"%past = phi {code.numbers} [ {code.constant('-1.0')}, %spheres ], [ %near.start.next, %settled ]",
             f"%past.ball = phi {code.integers} [ splat (i32 -1), %spheres ], [ %near.ball.next, %settled ]")


def next_ball(code: Vectors, end: str) -> Nearest:
    """Emits the search for the nearest sphere beyond `%past`; goes on at `all_balls` if no ray has one, else at `meet`.

    Args:
        end: where spheres must begin at the most; 0: none is wanted.
    """
    code.lay("br label %ball", "ball:", "%b = phi i64 [ 0, %search ], [ %b.next, %ball ]",
             f"%near.start = phi {code.numbers} [ {code.constant(INFINITY)}, %search ], [ %near.start.next, %ball ]",
             f"%near.ball = phi {code.integers} [ splat (i32 -1), %search ], [ %near.ball.next, %ball ]")
    start = code.line(f"load {code.numbers}, ptr {code.at(code.numbers, '%starts', '%b')}")
    number = code.splat(code.line("trunc i64 %b to i32"), "i32")
    later = code.both(code.compare(start, "oeq", "%past"), code.line(f"icmp sgt {code.integers} {number}, %past.ball"))
    later = code.either(later, code.compare(start, "ogt", "%past"))
    better = code.both(later, code.compare(start, "olt", "%near.start"))
    code.lay(f"%near.start.next = select {code.flags} {better}, {code.numbers} {start}, {code.numbers} %near.start",
             f"%near.ball.next = select {code.flags} {better}, {code.integers} {number}, {code.integers} %near.ball",
             "%b.next = add i64 %b, 1", "%b.more = icmp slt i64 %b.next, %ball_count",
             "br i1 %b.more, label %ball, label %nearest", "nearest:")
    before_end = code.both(code.compare("%near.start.next", "ole", end), code.compare(end, "ogt", ZERO))
    some = code.both(before_end, code.line(f"icmp sge {code.integers} %near.ball.next, {ZERO}"))
    branch_if_any(code, some, "meet", "all_balls")
    return Nearest(code.choose(some, "%near.ball.next", ZERO, "i32"), some)


def seen_from_ball(code: Vectors, rays: RayVector, placement: list[str]) -> Local:
    """Transforms rays into the frames of balls; `placement`: their rows of `BallTables.placements`."""
    rows = [placement[3:6], placement[6:9], placement[9:12]]
    away = [code.sub(o, centre) for o, centre in zip(rays.o, placement)]
    return Local([code.dot(row, away) for row in rows], [code.dot(row, rays.d) for row in rows])


def local_of(code: Vectors, rays: RayVector, ball: Nearest) -> Local:
    """Transforms each ray into the frame of its next ball."""
    place = code.line(f"mul {code.integers} {ball.number}, splat (i32 12)")
    return seen_from_ball(code, rays, [code.gather(code.scalar, "%placements", plus(code, place, number), ball.some)
                                       for number in range(12)])


def meet_sphere(code: Vectors, local: Local) -> SphereCrossing:
    """Intersects rays with the spheres around their balls: half a chord from the point closest to the centre."""
    o, d = local
    one = code.constant("1.0")
    shorter = code.div(one, code.dot(d, d))
    middle = code.negative(code.mul(code.dot(o, d), shorter))
    nearest = local.at(code, middle)
    inside = code.sub(one, code.dot(nearest, nearest))
    half = _square_root(code, code.mul(code.choose(code.compare(inside, "ogt", ZERO), inside, ZERO), shorter))
    enter, leave = code.sub(middle, half), code.add(middle, half)
    near = code.compare(code.dot(o, o), "ole", code.number(1 + NEAR))
    start = code.choose(near, ZERO, enter)
    ahead = code.both(code.compare(leave, "ogt", ZERO), code.either(near, code.compare(start, "ogt", ZERO)))
    return SphereCrossing(start, leave, near, code.both(code.compare(inside, "ogt", ZERO), ahead))


def meet_nearest(code: Vectors, rays: RayVector, ball: Nearest, end: str) -> tuple[str, str, Facet]:
    """Intersects each ray with the next ball along it; args and results as for `meet_ball`."""
    local = local_of(code, rays, ball)
    return meet_ball(code, local, meet_sphere(code, local), ball.some, end)


def meet_ball(code: Vectors, local: Local, sphere: SphereCrossing, some: str, end: str) -> tuple[str, str, Facet]:
    """Emits the intersection of rays with the facets of balls, up to the label `settled`.

    Args:
        local: the rays, each relative to its ball.
        sphere: where they meet the sphere around it.
        some: flags of rays that do.
        end: t where they end.

    Returns:
        Flags of those that hit at 0 < t <= `end`; t, and the facet that is hit.
    """
    one, near = code.constant("1.0"), code.both(some, sphere.near)
    code.lay("br label %begin_ball", "begin_ball:")

    # Rays that start inside look for the exit, from the other side.
    branch_if_any(code, near, "close", "aim")
    facet = facet_of(code, local.at(code, sphere.start), near)
    within = code.both(near, code.compare(code.dot(facet.n, local.o), "ole", one))
    code.lay("br label %aim", "aim:", f"%out = phi {code.flags} [ {ZERO}, %begin_ball ], [ {within}, %close ]")
    begin = code.choose("%out", sphere.leave, sphere.start)
    code.lay("br label %step", "step:", f"%reached = phi {code.numbers} [ {begin}, %aim ], [ %further, %step ]",
             f"%row = phi {code.integers} [ splat (i32 -1), %aim ], [ %row.next, %step ]",
             f"%column = phi {code.integers} [ splat (i32 -1), %aim ], [ %column.next, %step ]",
             f"%meeting = phi {code.flags} [ {some}, %aim ], [ %meeting.next, %step ]",
             "%steps = phi i64 [ 1, %aim ], [ %steps.next, %step ]")
    facet = facet_of(code, local.at(code, "%reached"), "%meeting")
    slope = code.dot(facet.n, local.d)
    falls = code.compare(code.choose("%out", code.negative(slope), slope), "olt", ZERO)
    unchanged = code.both(code.line(f"icmp eq {code.integers} {facet.row}, %row"),
                          code.line(f"icmp eq {code.integers} {facet.column}, %column"))
    crossing = code.div(code.sub(one, code.dot(facet.n, local.o)), slope)
    code.lay(f"%row.next = add {code.integers} {facet.row}, {ZERO}",
             f"%column.next = add {code.integers} {facet.column}, {ZERO}",
             f"%meeting.next = and {code.flags} %meeting, {falls}",
             f"%further = select {code.flags} {unchanged}, {code.numbers} %reached, {code.numbers} {crossing}",
             "%steps.next = add i64 %steps, 1")
    moving = code.both("%meeting.next", code.line(f"xor {code.flags} {unchanged}, splat (i1 true)"))
    left = code.line(f"icmp ne i64 {code.bits(moving)}, 0")
    again = code.line(f"and i1 {left}, {code.line(f'icmp slt i64 %steps, {STEPS}')}")
    code.lay(f"br i1 {again}, label %step, label %settled", "settled:")
    hit = code.both(code.compare("%further", "ogt", ZERO), code.compare("%further", "ole", end))
    return code.both("%meeting.next", hit), "%further", facet


def branch_if_any(code: Vectors, flags: str, to: str, otherwise: str) -> None:
    """Emits a branch to `to` if any flag is set; that label follows."""
    code.lay(f"br i1 {code.line(f'icmp ne i64 {code.bits(flags)}, 0')}, label %{to}, label %{otherwise}", f"{to}:")


def _square_root(code: Vectors, a: str) -> str:
    return code.call(f"llvm.sqrt.{code.suffix(code.scalar)}", code.numbers, (code.numbers, a))
