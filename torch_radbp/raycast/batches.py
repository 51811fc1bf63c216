"""The two ray casting loops for small meshes, as LLVM IR: batches of rays against the runs of `runs.py`.

A tree spends most of its time on branches that a processor cannot foresee, and on vectors of rays of which few want to know
what is looked at. Here a batch of some hundred rays takes the runs one by one: all are tested against the box of a run,
vector by vector, those that meet it are listed, and the listed ones are tested against its faces, again in full vectors.
Where most of a batch meet a box, all are tested where they lie, which is sooner done than picking some out. What a ray meets
does not depend on the others of its batch.

Reference: Barringer and Akenine-Moller 2014, "Dynamic ray stream traversal".
"""

from __future__ import annotations

from typing import NamedTuple

from torch_radbp.raycast import every_ball
from torch_radbp.raycast.batch import (
    DONE,
    INTEGERS,
    VIEW,
    again,
    begin,
    enter,
    greatest,
    list_of_box,
    listed_rays,
    loop,
    next_batch,
)
from torch_radbp.raycast.every_triangle import RayView, closer, crossing_of_both, place_on, struck, triangle_crossing
from torch_radbp.raycast.queries import RayVector, lanes_before, rays_among_lanes, write_hidden
from torch_radbp.raycast.runs import FEW
from torch_radbp.raycast.vectors import ZERO, Vectors

# What a vector of rays costs beside the faces of a run, in tests of one: of a list, and of rays that follow each other.
PICKED, FOLLOWING = 14, 4


class Listed(NamedTuple):
    """One vector of rays taken from a list of rays of a batch, such as those that meet a box."""

    mask: str  # flags of lanes within the list
    ray: str  # their places in the batch

    def view(self, code: Vectors) -> RayView:
        """The view of points along these rays, gathered from the batch."""
        return RayView.of(code.gather("i32" if name in INTEGERS else code.scalar, f"%ray.{name}", self.ray) for name in VIEW)

    def end(self, code: Vectors) -> str:
        """The greatest t of each ray, gathered from the batch; lanes beyond the list have one at which nothing is hit."""
        return code.choose(self.mask, code.gather(code.scalar, "%ray.end", self.ray), code.constant(DONE))

    def learn(self, code: Vectors, kind: str, name: str, value: str, where: str) -> None:
        """Scatters new values of a column of the batch's rays, such as their t, in lanes whose flag is set."""
        code.scatter(kind, value, f"%ray.{name}", self.ray, where)


class Following(NamedTuple):
    """One vector of consecutive rays of a batch, whether or not they meet a bounding box."""

    at: str

    def column(self, code: Vectors, name: str) -> str:
        """Loads a column of the batch for these rays."""
        kind = "i32" if name in INTEGERS else code.scalar
        return code.line(f"load {code.vector(kind)}, ptr {code.at(kind, f'%ray.{name}', self.at)}")

    def view(self, code: Vectors) -> RayView:
        """The view of points along these rays, loaded from the batch."""
        return RayView.of(self.column(code, name) for name in VIEW)

    def end(self, code: Vectors) -> str:
        """The greatest t of each ray, loaded from the batch."""
        return self.column(code, "end")

    def learn(self, code: Vectors, kind: str, name: str, value: str, where: str) -> None:
        """Stores new values of a column of the batch's rays, such as their t, in lanes whose flag is set."""
        code.store(code.vector(kind), code.choose(where, value, self.column(code, name), kind),
                   code.at(kind, f"%ray.{name}", self.at))


def seen_face(code: Vectors, row: str, corners: int) -> list[list[str]]:
    """The corners of a face of a run in the rays' own coordinates; `row`: of `Runs.faces`."""
    points = []
    for number in range(corners):
        corner = code.line(f"zext i32 {code.load('i32', row, number)} to i64")
        place = code.at(code.numbers, "%seen", code.line(f"mul i64 {code.line(f'sub i64 {corner}, %corner.first')}, 3"))
        points.append([code.load(code.numbers, place, k) for k in range(3)])
    return points


def tested(code: Vectors, row: str, parallelogram: bool, end: str, any_hit: bool) -> tuple[str, str, str]:
    """Tests rays against one face: flags of those that hit it, their t, and the number of the triangle, i32."""
    first = code.splat(code.load("i32", row, 4), "i32")
    if parallelogram:
        crossing, between = crossing_of_both(code, *seen_face(code, row, 4))
    else:
        crossing = triangle_crossing(code, *seen_face(code, row, 3))
    if any_hit:
        return struck(code, crossing, end), code.constant(DONE), first
    hit, distance = closer(code, crossing, end)
    if not parallelogram:
        return hit, distance, first
    beyond = code.compare(code.negated_where_negative(between, crossing.total), "olt", ZERO)
    return hit, distance, code.choose(beyond, code.splat(code.load("i32", row, 5), "i32"), first, "i32")


def test_run(code: Vectors, name: str, rays: Listed | Following, before: str, any_hit: bool) -> None:
    """Emits the test of a vector of rays against all faces of a run, from the label `before` to `<name>.tested`."""
    view = rays.view(code)

    # See the corners of the run.
    corner = f"{name}.corner"
    loop(code, corner, before, 1)
    row = code.line(f"mul i64 {code.line(f'add i64 %corner.first, %{corner}.at')}, 3")
    place, target = code.at(code.scalar, "%corners", row), code.at(code.numbers, "%seen",
                                                                  code.line(f"mul i64 %{corner}.at, 3"))
    seen = view.sees(code, [code.splat(code.load(code.scalar, place, k), code.scalar) for k in range(3)])
    for k, number in enumerate(seen):
        code.store(code.numbers, number, code.at(code.numbers, target, k))
    again(code, corner, "%corner.count", f"{name}.seen")

    # Test its faces.
    first_end = rays.end(code)
    code.lay(f"br i1 %parallelograms, label %{name}.two, label %{name}.one")
    for kind in ("one", "two"):
        face = f"{name}.{kind}.face"
        end, prim = f"%{face}.least", f"%{face}.met"
        code.lay(f"{name}.{kind}:")
        loop(code, face, f"{name}.{kind}", 1,
             f"{end} = phi {code.numbers} [ {first_end}, %{name}.{kind} ], [ {end}.next, %{face}.end ]",
             f"{prim} = phi {code.integers} [ splat (i32 -1), %{name}.{kind} ], [ {prim}.next, %{face}.end ]")
        row = code.at("[6 x i32]", "%faces", code.line(f"add i64 %face.first, %{face}.at"))
        hit, distance, number = tested(code, row, kind == "two", end, any_hit)
        code.lay(f"{end}.next = select {code.flags} {hit}, {code.numbers} {distance}, {code.numbers} {end}",
                 f"{prim}.next = select {code.flags} {hit}, {code.integers} {number}, {code.integers} {prim}")
        again(code, face, "%face.count", f"{name}.{kind}.all")
        code.lay(f"br label %{name}.tested")
    code.lay(f"{name}.tested:")
    end, prim = (code.line(f"phi {kind} [ %{name}.one.face.{which}.next, %{name}.one.all ], "
                           f"[ %{name}.two.face.{which}.next, %{name}.two.all ]")
                 for kind, which in ((code.numbers, "least"), (code.integers, "met")))
    met = code.line(f"icmp sge {code.integers} {prim}, {ZERO}")
    rays.learn(code, code.scalar, "end", end, met)
    if not any_hit:
        rays.learn(code, "i32", "prim", prim, met)


def _search(code: Vectors, before: str, count: str, any_hit: bool) -> None:
    """Emits the search for hits of a batch of `count` rays in all runs, from the label `before` to `answer`."""
    loop(code, "run", before, 1)
    this, following = (code.at("[3 x i32]", "%firsts", run) for run in ("%run.at", "%run.next"))
    for which, name in enumerate(("face", "corner")):
        for border, at in (("first", this), ("last", following)):
            code.lay(f"%{name}.{border} = zext i32 {code.load('i32', at, which)} to i64")
        code.lay(f"%{name}.count = sub i64 %{name}.last, %{name}.first")
    code.lay(f"%parallelograms = icmp ne i32 {code.load('i32', this, 2)}, 0")
    list_of_box(code, "box", "%run.next", "run", count)

    # Where many of the batch meet the box, all are tested: to pick some out takes as long as some triangles more.
    of_listed, of_all = (code.line(f"add i64 %face.count, {more}") for more in (PICKED, FOLLOWING))
    of_listed, of_all = code.line(f"mul i64 %box.listed, {of_listed}"), code.line(f"mul i64 {count}, {of_all}")
    code.lay(f"%many = icmp sgt i64 {of_listed}, {of_all}", "br i1 %many, label %many_rays, label %few_rays", "many_rays:")
    loop(code, "all", "many_rays", code.width)
    test_run(code, "all", Following("%all.at"), "all", any_hit)
    again(code, "all", count, "all_tested")
    code.lay("br label %run.end", "few_rays:")
    loop(code, "test", "few_rays", code.width)
    test_run(code, "test", Listed(*listed_rays(code, "%box.listed", "%test.at")), "test", any_hit)
    again(code, "test", "%box.listed", "tested_all")
    again(code, "run", "%run_count", "answer")


def search_balls(code: Vectors, before: str, count: str, columns: list[str], any_hit: bool) -> None:
    """Emits the search for hits of a batch of rays among balls, from `before` to `ball_answer`; boxes of balls follow those
    of runs.

    Args:
        columns: the addresses of the components of all lanes' rays.
        before, count, any_hit: as for `_search`.
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
    rays = RayVector(o_and_d[:3], o_and_d[3:], mask)
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


def columns_at(code: Vectors, triangle: str, before: str) -> tuple[list[str], str]:
    """Loads the nine coordinates of the corners of one triangle (i32) per lane; emitted from the label `before` to the
    returned one.
    """
    starts = [code.at(code.scalar, "%by_triangle", code.line(f"mul i64 %columns, {number}")) for number in range(9)]
    if not code.permutes:
        return [code.gather(code.scalar, start, triangle) for start in starts], before
    name = f"{before}.read"
    code.lay(f"%{name}.few = icmp sle i64 %columns, {FEW}",
             f"br i1 %{name}.few, label %{name}.near, label %{name}.far", f"{name}.near:")
    near = [code.permuted(start, triangle, FEW) for start in starts]
    code.lay(f"br label %{name}", f"{name}.far:")
    far = [code.gather(code.scalar, start, triangle) for start in starts]
    code.lay(f"br label %{name}", f"{name}:")
    return [code.line(f"phi {code.numbers} [ {one}, %{name}.near ], [ {other}, %{name}.far ]")
            for one, other in zip(near, far)], name


def closest_hit_of_batches(code: Vectors, balls: bool) -> str:
    """The LLVM IR of the closest-hit loop: prim, u, v and t of every lane; of several hits at one distance the first."""
    columns = begin(code, balls, columns=6, outputs=4)

    def rays_at(at: str) -> tuple[str, RayVector]:
        mask = lanes_before(code, "%count", at)
        return mask, rays_among_lanes(code, [code.load_where(mask, column, at) for column in columns], mask)

    loop(code, "enter", "batch", code.width)
    enter(code, rays_at("%enter.at")[1], "%enter.at", None)
    code.store(code.integers, code.counted("%enter.at"), code.at("i32", "%ray.lane", "%enter.at"))
    again(code, "enter", "%count", "entered")
    _search(code, "entered", "%count", any_hit=False)
    if balls:
        search_balls(code, "answer", "%count", columns, any_hit=False)

    # Say where they are hit.
    loop(code, "locate", "ball_answer" if balls else "answer", code.width)
    batch = Following("%locate.at")
    view, prim, unit = batch.view(code), batch.column(code, "prim"), batch.column(code, "unit")
    is_hit = code.line(f"icmp sge {code.integers} {prim}, {ZERO}")
    numbers, label = columns_at(code, code.choose(is_hit, prim, ZERO, "i32"), "locate")
    corners = [view.sees(code, numbers[number:number + 3]) for number in (0, 3, 6)]
    answers = (prim, *(code.choose(is_hit, answer, ZERO) for answer in place_on(code, corners, unit)))
    mask = lanes_before(code, "%count", "%locate.at")
    if balls:
        rays = rays_at("%locate.at")[1]
        ball, row, column = (batch.column(code, name) for name in ("ball", "row", "column"))
        t = batch.column(code, "t")
        t = code.choose(code.line(f"icmp sge {code.integers} {ball}, {ZERO}"), t, answers[3])
        others = [every_ball.numbers_in_mesh(code, prim), *answers[1:3]]
        answers = every_ball.placed(code, rays, (ball, row, column), t, others, label)
    for number, (kind, answer) in enumerate(zip(("i32", *[code.scalar] * 3), answers)):
        code.store_where(mask, kind, answer, code.at(kind, f"%out{number}", "%base"), "%locate.at")
    again(code, "locate", "%count", "located_all")
    code.lay("br label %answered_all")
    return next_batch(code)


def any_hit_of_batches(code: Vectors, balls: bool) -> str:
    """The LLVM IR of the occlusion loop: 1 in every lane with a triangle at 0 < t <= tmax, else 0, as bytes.

    Lanes without a segment cost next to nothing: the others come together.
    """
    *columns, end = begin(code, balls, columns=7, outputs=1)
    code.lay("%hidden = getelementptr i8, ptr %out0, i64 %base")
    loop(code, "segment", "batch", code.width, "%segment.found = phi i64 [ 0, %batch ], [ %segments, %segment.end ]")
    mask = lanes_before(code, "%count", "%segment.at")
    rays = rays_among_lanes(code, [code.load_where(mask, column, "%segment.at") for column in columns], mask)
    some = code.both(rays.valid, code.compare(code.load_where(mask, end, "%segment.at"), "ogt", ZERO))
    code.store_where(mask, "i8", ZERO, "%hidden", "%segment.at")
    lanes = code.counted("%segment.at")
    code.lay(f"store {code.integers} {code.compressed(lanes, some)}, ptr "
             f"{code.at('i32', '%ray.lane', '%segment.found')}, align 4",
             f"%segments = add i64 %segment.found, {code.count(some)}")
    again(code, "segment", "%count", "segments_all")
    code.lay("%some_segments = icmp sgt i64 %segments, 0",
             "br i1 %some_segments, label %entering, label %answered_all", "entering:",
             "%all_segments = icmp eq i64 %segments, %count",
             "br i1 %all_segments, label %entering_all, label %entering_some", "entering_all:")

    # Where all lanes have one, none is picked out.
    loop(code, "every", "entering_all", code.width)
    mask = lanes_before(code, "%count", "%every.at")
    *o_and_d, tmax = (code.load_where(mask, column, "%every.at") for column in (*columns, end))
    enter(code, RayVector(o_and_d[:3], o_and_d[3:], mask), "%every.at", tmax)
    again(code, "every", "%count", "entered_all")
    code.lay("br label %entered", "entering_some:")
    loop(code, "enter", "entering_some", code.width)
    mask = lanes_before(code, "%segments", "%enter.at")
    lanes = code.line(f"load {code.integers}, ptr {code.at('i32', '%ray.lane', '%enter.at')}, align 4")
    *o_and_d, tmax = (code.gather(code.scalar, column, lanes, mask) for column in (*columns, end))
    enter(code, RayVector(o_and_d[:3], o_and_d[3:], mask), "%enter.at", tmax)
    again(code, "enter", "%segments", "entered_some")
    code.lay("br label %entered", "entered:")
    _search(code, "entered", "%segments", any_hit=True)

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
