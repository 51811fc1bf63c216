"""The two loops over lanes for small meshes, as LLVM's text: batches of rays against the runs of `runs.py`.

A tree spends most of its time on branches that a processor cannot foresee, and on vectors of rays of which few want to know
what is looked at. Here a batch of some hundred rays takes the runs one by one: all are tested against the box of a run,
vector by vector, those that meet it are listed, and the listed ones are tested against its triangles, again in full vectors.
What a ray meets does not depend on the others of its batch.

Reference: Barringer and Akenine-Moller 2014, "Dynamic ray stream traversal".
"""

from __future__ import annotations

from torch_radbp.raycast import every_ball
from torch_radbp.raycast.batch import (
    DONE,
    again,
    begin,
    enter,
    greatest,
    list_of_box,
    listed_rays,
    loop,
    next_batch,
)
from torch_radbp.raycast.every_triangle import View, closer, place_on, struck, view_along
from torch_radbp.raycast.queries import Rays, lanes_before, rays_of, write_hidden
from torch_radbp.raycast.vectors import ZERO, Vectors


def seen_triangle(code: Vectors) -> list[list[str]]:
    """The corners of the triangle `%triangle.at` of the run, as rays see them."""
    row = code.at("i32", "%triangles", code.line("mul i64 %triangle.number, 3"))
    corners = []
    for number in range(3):
        corner = code.line(f"zext i32 {code.load('i32', row, number)} to i64")
        place = code.at(code.numbers, "%seen", code.line(f"mul i64 {code.line(f'sub i64 {corner}, %corner.first')}, 3"))
        corners.append([code.load(code.numbers, place, k) for k in range(3)])
    return corners


def search(code: Vectors, before: str, count: str, any_hit: bool) -> None:
    """Lays the search for what the rays of the batch meet, `count` of them, from the label `before` to `answer`."""
    loop(code, "run", before, 1)
    for name, which in (("triangle", 0), ("corner", 1)):
        for border, run in (("first", "%run.at"), ("last", "%run.next")):
            at = code.at("[2 x i32]", "%firsts", run)
            code.lay(f"%{name}.{border} = zext i32 {code.load('i32', at, which)} to i64")
        code.lay(f"%{name}.count = sub i64 %{name}.last, %{name}.first")
    list_of_box(code, "box", "%run.next", "run", count)
    loop(code, "test", "run.some", code.width)
    mask, ray = listed_rays(code, "%box.listed", "%test.at")
    known = {name: code.gather(code.scalar, f"%ray.{name}", ray)
             for name in ("x", "y", "z", "first_slope", "second_slope", "end")}
    view = View([known[axis] for axis in "xyz"], [known["first_slope"], known["second_slope"]],
                code.gather("i32", "%ray.axis", ray))

    # See the corners of the run.
    loop(code, "corner", "test", 1)
    row = code.line(f"mul i64 {code.line('add i64 %corner.first, %corner.at')}, 3")
    place, target = code.at(code.scalar, "%corners", row), code.at(code.numbers, "%seen", code.line("mul i64 %corner.at, 3"))
    corner = view.sees(code, [code.splat(code.load(code.scalar, place, k), code.scalar) for k in range(3)])
    for k, number in enumerate(corner):
        code.store(code.numbers, number, code.at(code.numbers, target, k))
    again(code, "corner", "%corner.count", "seen_all")

    # Test its triangles.
    end = code.choose(mask, known["end"], code.constant(DONE))
    loop(code, "triangle", "seen_all", 1,
         f"%end = phi {code.numbers} [ {end}, %seen_all ], [ %end.next, %triangle.end ]",
         f"%prim = phi {code.integers} [ splat (i32 -1), %seen_all ], [ %prim.next, %triangle.end ]",
         "%triangle.number = add i64 %triangle.first, %triangle.at")
    if any_hit:
        hit, end = struck(code, seen_triangle(code), "%end"), code.constant(DONE)
    else:
        hit, end = closer(code, seen_triangle(code), "%end")
    number = code.splat(code.line("trunc i64 %triangle.number to i32"), "i32")
    code.lay(f"%end.next = select {code.flags} {hit}, {code.numbers} {end}, {code.numbers} %end",
             f"%prim.next = select {code.flags} {hit}, {code.integers} {number}, {code.integers} %prim")
    again(code, "triangle", "%triangle.count", "tested")
    met = code.line(f"icmp sge {code.integers} %prim.next, {ZERO}")
    code.scatter(code.scalar, "%end.next", "%ray.end", ray, met)
    if not any_hit:
        code.scatter("i32", "%prim.next", "%ray.prim", ray, met)
    again(code, "test", "%box.listed", "tested_all")
    again(code, "run", "%run_count", "answer")


def search_balls(code: Vectors, before: str, count: str, columns: list[str], any_hit: bool) -> None:
    """Lays the same search among balls, from `before` to `ball_answer`; their boxes come behind those of runs.

    Args:
        columns: addresses of what the lanes hold of their rays.
        before, count, any_hit: as for `search`.
    """
    loop(code, "ball", before, 1)
    code.lay("%ball.box = add i64 %run_count, %ball.next")
    list_of_box(code, "sphere", "%ball.box", "ball", count)
    place = code.at(code.scalar, "%placements", code.line("mul i64 %ball.at, 12"))
    placement = [code.splat(code.load(code.scalar, place, number), code.scalar) for number in range(12)]
    number = code.splat(code.line("trunc i64 %ball.at to i32"), "i32")
    loop(code, "approach", "ball.some", code.width)
    mask, ray = listed_rays(code, "%sphere.listed", "%approach.at")
    lane = code.gather("i32", "%ray.lane", ray)
    o_and_d = [code.gather(code.scalar, column, lane, mask) for column in columns]
    rays = Rays(o_and_d[:3], o_and_d[3:], mask)
    unit = code.mul(greatest(code, rays.d), code.splat("%scale", code.scalar))
    end = code.choose(mask, code.div(code.gather(code.scalar, "%ray.end", ray), unit), code.constant(DONE))
    local = every_ball.seen_from_ball(code, rays, placement)
    sphere = every_ball.meet_sphere(code, local)
    hit, t, facet = every_ball.meet_ball(code, local, sphere, code.both(mask, sphere.met), end)
    if any_hit:
        code.scatter(code.scalar, code.constant(DONE), "%ray.end", ray, hit)
    else:
        code.scatter(code.scalar, code.mul(t, unit), "%ray.end", ray, hit)
        code.scatter(code.scalar, t, "%ray.t", ray, hit)
        for name, value in (("ball", number), ("row", facet.row), ("column", facet.column)):
            code.scatter("i32", value, f"%ray.{name}", ray, hit)
    again(code, "approach", "%sphere.listed", "met_all")
    again(code, "ball", "%ball_count", "ball_answer")


def closest_hit(code: Vectors, balls: bool) -> str:
    """The text of the loop for closest hits: prim, u, v and t of every lane; of several at one distance the first."""
    columns = begin(code, balls, columns=6, outputs=4)

    def rays_at(at: str) -> tuple[str, Rays]:
        mask = lanes_before(code, "%count", at)
        return mask, rays_of(code, [code.load_where(mask, column, at) for column in columns], mask)

    loop(code, "enter", "batch", code.width)
    enter(code, rays_at("%enter.at")[1], "%enter.at", None)
    code.store(code.integers, code.counted("%enter.at"), code.at("i32", "%ray.lane", "%enter.at"))
    again(code, "enter", "%count", "entered")
    search(code, "entered", "%count", any_hit=False)
    if balls:
        search_balls(code, "answer", "%count", columns, any_hit=False)

    # Say where they are hit.
    loop(code, "locate", "ball_answer" if balls else "answer", code.width)
    mask, rays = rays_at("%locate.at")
    view, unit = view_along(code, rays)
    prim = code.line(f"load {code.integers}, ptr {code.at('i32', '%ray.prim', '%locate.at')}")
    found = code.line(f"icmp sge {code.integers} {prim}, {ZERO}")
    row = code.line(f"mul {code.integers} {code.choose(found, prim, ZERO, 'i32')}, splat (i32 3)")
    corners = []
    for number in range(3):
        corner = code.gather("i32", "%triangles", code.line(f"add {code.integers} {row}, splat (i32 {number})"))
        at = code.line(f"mul {code.integers} {corner}, splat (i32 3)")
        corners.append(view.sees(code, [code.gather(code.scalar, "%corners", code.line(
            f"add {code.integers} {at}, splat (i32 {k})")) for k in range(3)]))
    answers = (prim, *(code.choose(found, answer, ZERO) for answer in place_on(code, corners, unit)))
    if balls:
        ball, row, column = (code.line(f"load {code.integers}, ptr {code.at('i32', f'%ray.{name}', '%locate.at')}")
                             for name in ("ball", "row", "column"))
        t = code.line(f"load {code.numbers}, ptr {code.at(code.scalar, '%ray.t', '%locate.at')}")
        t = code.choose(code.line(f"icmp sge {code.integers} {ball}, {ZERO}"), t, answers[3])
        others = [every_ball.numbers_of(code, prim), *answers[1:3]]
        answers = every_ball.placed(code, rays, (ball, row, column), t, others, "locate")
    for number, (kind, answer) in enumerate(zip(("i32", *[code.scalar] * 3), answers)):
        code.store_where(mask, kind, answer, code.at(kind, f"%out{number}", "%base"), "%locate.at")
    again(code, "locate", "%count", "located_all")
    code.lay("br label %answered_all")
    return next_batch(code)


def any_hit(code: Vectors, balls: bool) -> str:
    """The text of the loop for occlusion: 1 in every lane with a triangle at 0 < t <= tmax, else 0, as bytes.

    Lanes without a segment cost next to nothing: the others come together.
    """
    *columns, end = begin(code, balls, columns=7, outputs=1)
    code.lay("%hidden = getelementptr i8, ptr %out0, i64 %base")
    loop(code, "segment", "batch", code.width, "%segment.found = phi i64 [ 0, %batch ], [ %segments, %segment.end ]")
    mask = lanes_before(code, "%count", "%segment.at")
    rays = rays_of(code, [code.load_where(mask, column, "%segment.at") for column in columns], mask)
    some = code.both(rays.valid, code.compare(code.load_where(mask, end, "%segment.at"), "ogt", ZERO))
    code.store_where(mask, "i8", ZERO, "%hidden", "%segment.at")
    lanes = code.counted("%segment.at")
    code.lay(f"store {code.integers} {code.compressed(lanes, some)}, ptr "
             f"{code.at('i32', '%ray.lane', '%segment.found')}, align 4",
             f"%segments = add i64 %segment.found, {code.count(some)}")
    again(code, "segment", "%count", "segments_all")
    code.lay("%some_segments = icmp sgt i64 %segments, 0",
             "br i1 %some_segments, label %entering, label %answered_all", "entering:")

    loop(code, "enter", "entering", code.width)
    mask = lanes_before(code, "%segments", "%enter.at")
    lanes = code.line(f"load {code.integers}, ptr {code.at('i32', '%ray.lane', '%enter.at')}, align 4")
    *o_and_d, tmax = (code.gather(code.scalar, column, lanes, mask) for column in (*columns, end))
    enter(code, Rays(o_and_d[:3], o_and_d[3:], mask), "%enter.at", tmax)
    again(code, "enter", "%segments", "entered")
    search(code, "entered", "%segments", any_hit=True)

    if balls:
        search_balls(code, "answer", "%segments", columns, any_hit=True)

    # Only lanes that are hidden have to be written.
    loop(code, "write", "ball_answer" if balls else "answer", code.width)
    left = code.line(f"load {code.numbers}, ptr {code.at(code.scalar, '%ray.end', '%write.at')}")
    hidden = code.both(lanes_before(code, "%segments", "%write.at"), code.compare(left, "olt", ZERO))
    write_hidden(code, hidden, code.at("i32", "%ray.lane", "%write.at"), "written")
    again(code, "write", "%segments", "written_all")
    code.lay("br label %answered_all")
    return next_batch(code)
