"""Loops that test every triangle of a mesh against vectors of rays, as LLVM's text for any width and type of numbers.

The corners of the mesh are first seen along the rays: relative to the ray's origin, and sheared so that the ray runs along
its greatest axis at x = y = 0. Each corner is moved once for all of its triangles, and the edge function x0 y1 - x1 y0 of an
edge has exactly the opposite value in the triangle on its other side. A triangle is hit unless two of its edge functions
have opposite signs, so that no ray slips between two triangles.

Reference: Woop, Benthin and Wald 2013, "Watertight ray/triangle intersection".
"""

from __future__ import annotations

from typing import NamedTuple

from torch_radbp.raycast.vectors import ZERO, Vectors

INFINITY = "0x7FF0000000000000"


class View(NamedTuple):
    """How a vector of rays sees points that are given relative to its origins."""

    rows: list[list[str]]  # x, y, and the distance along the greatest axis of d, in units of the mesh
    unit: str  # length of d on that axis, in those units
    valid: str  # flags: the ray is finite and has a direction


def begin(code: Vectors, columns: int, outputs: int) -> list[str]:
    """Lays the head of a loop and gives the addresses of its inputs with an entry per lane.

    The others are `%corners`, numbers (V, 3) in units of the mesh; `%triangles`, i32 (F, 3); and the number of corners, that
    of triangles, both i64, and the scale of coordinates in units of the mesh. Outputs are `%out0` and so on.
    """
    code.lay("entry:")
    for number in range(outputs):
        code.lay(f"%out{number} = load ptr, ptr {code.at('ptr', '%outputs', number)}")
    for number, name in enumerate(("corners", "triangles", "corner_count_at", "triangle_count_at", "scale_at"), columns):
        code.lay(f"%{name} = load ptr, ptr {code.at('ptr', '%inputs', number)}")
    code.lay("%corner_count = load i64, ptr %corner_count_at", "%triangle_count = load i64, ptr %triangle_count_at",
             f"%scale = load {code.scalar}, ptr %scale_at",
             "%seen_count = mul i64 %corner_count, 3", f"%seen = alloca {code.numbers}, i64 %seen_count")
    return [code.load("ptr", "%inputs", number) for number in range(columns)]


def lanes_before(code: Vectors, end: str, at: str) -> str:
    """Flags of the lanes of the vector that starts at `at` and come before `end`; both i64."""
    left = code.splat(code.line(f"sub i64 {end}, {at}"), "i64")
    return code.line(f"icmp slt {code.vector('i64')} {code.steps('i64')}, {left}")


def view_along(code: Vectors, o: list[str], d: list[str]) -> View:
    """How rays see points: the greatest component of the direction is the axis along which they run."""
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

    zero_if_finite = ZERO
    for component in (*o, *d):
        zero_if_finite = code.add(zero_if_finite, code.line(f"fmul {code.numbers} {component}, {ZERO}"))
    valid = code.both(code.compare(zero_if_finite, "oeq", ZERO), code.compare(greatest, "one", ZERO))
    return View(rows, code.mul(code.magnitude(greatest), code.splat("%scale", code.scalar)), valid)


def in_units_of_mesh(code: Vectors, o: list[str]) -> list[str]:
    scale = code.splat("%scale", code.scalar)
    return [code.line(f"fmul {code.numbers} {component}, {scale}") for component in o]


def see_corners(code: Vectors, o: list[str], view: View, before: str) -> None:
    """Lays the loop that stores in `%seen` how rays from `o` see each corner, and after it the label `ready`.

    `before` is the label that comes first.
    """
    code.lay(f"br label %corner\ncorner:\n%c = phi i64 [ 0, %{before} ], [ %c.next, %corner ]")
    row = code.line("mul i64 %c, 3")
    place, target = code.at(code.scalar, "%corners", row), code.at(code.numbers, "%seen", row)
    away = [code.sub(code.splat(code.load(code.scalar, place, k), code.scalar), o[k]) for k in range(3)]
    for k, row in enumerate(view.rows):
        code.store(code.numbers, code.dot(row, away), code.at(code.numbers, target, k))
    code.lay("%c.next = add i64 %c, 1", "%c.more = icmp slt i64 %c.next, %corner_count",
             "br i1 %c.more, label %corner, label %ready", "ready:", "br label %triangle")


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


def closest_hit(width: int, scalar: str) -> str:
    """The text of the loop for closest hits: prim, u, v and t of every lane; of several at one distance the first."""
    code = Vectors(width, scalar)
    columns = begin(code, columns=6, outputs=4)
    code.lay("br label %vector\nvector:\n%at = phi i64 [ %first, %entry ], [ %at.next, %found ]")
    mask = lanes_before(code, "%last", "%at")
    ray = [code.load_where(mask, column, "%at") for column in columns]
    view = view_along(code, ray[:3], ray[3:])
    o = in_units_of_mesh(code, ray[:3])
    farthest = code.choose(view.valid, code.constant(INFINITY), ZERO)
    see_corners(code, o, view, before="vector")

    # Keep the closest triangle.
    code.lay("triangle:", "%k = phi i64 [ 0, %ready ], [ %k.next, %triangle ]",
             f"%best = phi {code.numbers} [ {farthest}, %ready ], [ %best.next, %triangle ]",
             f"%prim = phi {code.integers} [ splat (i32 -1), %ready ], [ %prim.next, %triangle ]")
    weights, total, distance = crossing(code, *seen_triangle(code))
    distance = code.rough_div(distance, total)
    closer = code.both(code.compare(distance, "ogt", ZERO), code.compare(distance, "olt", "%best"))
    hit = code.both(inside(code, weights), closer)
    number = code.splat(code.line("trunc i64 %k to i32"), "i32")
    code.lay(f"%best.next = select {code.flags} {hit}, {code.numbers} {distance}, {code.numbers} %best",
             f"%prim.next = select {code.flags} {hit}, {code.integers} {number}, {code.integers} %prim",
             "%k.next = add i64 %k, 1", "%k.more = icmp slt i64 %k.next, %triangle_count",
             "br i1 %k.more, label %triangle, label %found", "found:")

    # Say where that triangle is hit.
    found = code.line(f"icmp sge {code.integers} %prim.next, {ZERO}")
    row = code.line(f"mul {code.integers} {code.choose(found, '%prim.next', ZERO, 'i32')}, splat (i32 3)")
    corners = []
    for number in range(3):
        corner = code.gather("i32", "%triangles", code.line(f"add {code.integers} {row}, splat (i32 {number})"))
        place = code.line(f"mul {code.integers} {corner}, splat (i32 3)")
        places = [code.line(f"add {code.integers} {place}, splat (i32 {k})") for k in range(3)]
        away = [code.sub(code.gather(scalar, "%corners", places[k]), o[k]) for k in range(3)]
        corners.append([code.dot(row, away) for row in view.rows])
    weights, total, distance = crossing(code, *corners)
    code.store_where(mask, "i32", "%prim.next", "%out0", "%at")
    answers = [code.div(weights[1], total), code.div(weights[2], total), code.div(code.div(distance, total), view.unit)]
    for number, answer in enumerate(answers, start=1):
        code.store_where(mask, scalar, code.choose(found, answer, ZERO), f"%out{number}", "%at")
    code.lay(f"%at.next = add i64 %at, {width}", "%at.more = icmp slt i64 %at.next, %last",
             "br i1 %at.more, label %vector, label %done", "done:", "ret void")
    return code.text()


def any_hit(width: int, scalar: str) -> str:
    """The text of the loop for occlusion: 1 in every lane with a triangle at 0 < t <= tmax, else 0, as bytes.

    Lanes without a segment cost next to nothing: the others queue up until they fill a vector.
    """
    code = Vectors(width, scalar)
    columns = [code.at(scalar, column, "%first") for column in begin(code, columns=7, outputs=1)]
    code.lay("%hidden = getelementptr i8, ptr %out0, i64 %first", "%lanes = sub i64 %last, %first",
             f"%queue = alloca i32, i64 {3 * width}", "br label %fill")

    # Queue the lanes that have a segment.
    code.lay("fill:", "%at = phi i64 [ 0, %entry ], [ %at.next, %next ]",
             "%waiting = phi i64 [ 0, %entry ], [ %length, %next ]")
    mask = lanes_before(code, "%lanes", "%at")
    segment = code.both(mask, code.compare(code.load_where(mask, columns[6], "%at"), "ogt", ZERO))
    code.store_where(mask, "i8", ZERO, "%hidden", "%at")
    lanes = code.line(f"add {code.integers} {code.steps('i32')}, {code.splat(code.line('trunc i64 %at to i32'), 'i32')}")
    packed = code.call(f"llvm.experimental.vector.compress.v{width}i32", code.integers, (code.integers, lanes),
                       (code.flags, segment), (code.integers, ZERO))
    code.lay(f"store {code.integers} {packed}, ptr {code.at('i32', '%queue', '%waiting')}, align 4")
    count = code.call("llvm.ctpop.i64", "i64", ("i64", code.bits(segment)))
    queued = code.line(f"add i64 %waiting, {count}")
    code.lay(f"%at.next = add i64 %at, {width}", "%at.more = icmp slt i64 %at.next, %lanes", "br label %decide")

    # Cast a full vector, and in the end what is left.
    code.lay("decide:", f"%length = phi i64 [ {queued}, %fill ], [ %rest, %shift ]",
             f"%full = icmp sge i64 %length, {width}", "%some = icmp sgt i64 %length, 0",
             "%due = select i1 %at.more, i1 %full, i1 %some", "br i1 %due, label %cast, label %next",
             "next:", "br i1 %at.more, label %fill, label %done", "done:", "ret void", "cast:")
    mask = lanes_before(code, "%length", "0")
    queue = code.line(f"load {code.integers}, ptr %queue, align 4")
    ray = [code.gather(scalar, column, queue, mask) for column in columns]
    view = view_along(code, ray[:3], ray[3:6])
    end = code.choose(view.valid, code.mul(ray[6], view.unit), ZERO)
    see_corners(code, in_units_of_mesh(code, ray[:3]), view, before="cast")

    code.lay("triangle:", "%k = phi i64 [ 0, %ready ], [ %k.next, %triangle ]",
             f"%met = phi {code.flags} [ {ZERO}, %ready ], [ %met.next, %triangle ]")
    weights, total, distance = crossing(code, *seen_triangle(code))
    distance = code.negated_where_negative(distance, total)  # and so is what it is compared to: no division
    before_end = code.compare(distance, "ole", code.mul(end, code.magnitude(total)))
    hit = code.both(inside(code, weights), code.both(code.compare(distance, "ogt", ZERO), before_end))
    code.lay(f"%met.next = or {code.flags} %met, {hit}",
             "%k.next = add i64 %k, 1", "%k.more = icmp slt i64 %k.next, %triangle_count",
             "br i1 %k.more, label %triangle, label %answer")

    # Only lanes that are hidden have to be written.
    code.lay("answer:")
    met = code.bits("%met.next")
    code.lay(f"%any = icmp ne i64 {met}, 0", "br i1 %any, label %write, label %shift",
             "write:", f"%bits = phi i64 [ {met}, %answer ], [ %bits.next, %write ]")
    first = code.call("llvm.cttz.i64", "i64", ("i64", "%bits"), ("i1", "true"))
    lane = code.line(f"zext i32 {code.load('i32', '%queue', first)} to i64")
    code.lay(f"store i8 1, ptr {code.at('i8', '%hidden', lane)}",
             "%lower = sub i64 %bits, 1", "%bits.next = and i64 %bits, %lower", "%bits.more = icmp ne i64 %bits.next, 0",
             "br i1 %bits.more, label %write, label %shift", "shift:")
    behind = code.line(f"load {code.integers}, ptr {code.at('i32', '%queue', width)}, align 4")
    left = code.call("llvm.smax.i64", "i64", ("i64", code.line(f"sub i64 %length, {width}")), ("i64", "0"))
    code.lay(f"store {code.integers} {behind}, ptr %queue, align 4", f"%rest = add i64 {left}, 0", "br label %decide")
    return code.text()
