"""A batch of rays as LLVM IR: the arrays that hold its rays, and the list of those that meet a box; see `batches.py`.

A box is met if it is within rounding: by more than corners move that are seen along a ray.
"""

from __future__ import annotations

from torch_radbp.raycast import every_ball
from torch_radbp.raycast.every_triangle import view_along
from torch_radbp.raycast.queries import INFINITY, RayVector, lanes_before
from torch_radbp.raycast.runs import MOST
from torch_radbp.raycast.vectors import ZERO, Vectors

BATCH = 512  # rays: few enough that what is known of them stays in the nearest cache
# As `runs.Runs`.
INPUTS = ("corners", "faces", "by_triangle", "columns_at", "boxes", "firsts", "run_count_at", "scale_at")
# What is known of the rays of a batch: how they see points; the length of 1 along them; 1 over the direction, of length 1
# along the axis; by how much boxes are widened; where the search ends, negative where it has; and in the end t where a ball
# is met. The flags of `RayView.axis`; the lane; the triangle that is met, the ball, and row and column of its facet.
NUMBERS = ("x", "y", "z", "first_slope", "second_slope", "unit", "over_x", "over_y", "over_z", "margin", "end", "t")
VIEW = ("x", "y", "z", "first_slope", "second_slope", "axis")  # what a `RayView` is made of
INTEGERS = ("axis", "lane", "prim", "ball", "row", "column")
WIDER = 2.0**-20  # the margin, of the distance to the farthest corner
STEEPEST = 2.0**40  # the most of 1 over a direction
DONE = "-1.0"


def begin(code: Vectors, balls: bool, columns: int, outputs: int) -> list[str]:
    """Emits the head of a loop over batches, up to the label `batch`, and returns the addresses of the inputs of each
    lane.
    """
    code.lay("entry:")
    for number in range(outputs):
        code.lay(f"%out{number} = load ptr, ptr {code.at('ptr', '%outputs', number)}")
    for number, name in enumerate((*INPUTS, *(every_ball.INPUTS if balls else ())), columns):
        code.lay(f"%{name} = load ptr, ptr {code.at('ptr', '%inputs', number)}")
    columns_at = [code.load("ptr", "%inputs", number) for number in range(columns)]
    code.lay("%run_count = load i64, ptr %run_count_at", "%columns = load i64, ptr %columns_at",
             f"%scale = load {code.scalar}, ptr %scale_at")
    code.lay(f"%seen = alloca {code.numbers}, i64 {12 * MOST}, align 64")  # the corners of a run
    vectors = BATCH // code.width + 1  # what is listed is written vector by vector, the last beyond its end
    code.lay(*(f"%ray.{name} = alloca {code.numbers}, i64 {vectors}, align 64" for name in NUMBERS),
             *(f"%ray.{name} = alloca {code.integers}, i64 {vectors}, align 64" for name in INTEGERS),
             f"%list = alloca {code.integers}, i64 {vectors}, align 64")
    if balls:
        every_ball.prepare(code)
    code.lay("br label %batch", "batch:", "%base = phi i64 [ %first, %entry ], [ %base.next, %answered_all ]")
    left = code.line("sub i64 %last, %base")
    code.lay(f"%count = call i64 @llvm.smin.i64(i64 {left}, i64 {BATCH})")
    code.declared["llvm.smin.i64"] = "declare i64 @llvm.smin.i64(i64, i64)"
    return [code.at(code.scalar, column, "%base") for column in columns_at]


def next_batch(code: Vectors) -> str:
    """Emits the end of the loop over batches and returns the whole text."""
    code.lay("answered_all:", f"%base.next = add i64 %base, {BATCH}", "%base.more = icmp slt i64 %base.next, %last",
             "br i1 %base.more, label %batch, label %done", "done:", "ret void")
    return code.text()


def loop(code: Vectors, name: str, before: str, step: int, *carried: str) -> None:
    """Emits the head of a loop with the counter `%<name>.at`, which begins at 0 after the label `before`."""
    code.lay(f"br label %{name}", f"{name}:", f"%{name}.at = phi i64 [ 0, %{before} ], [ %{name}.next, %{name}.end ]",
             *carried, f"%{name}.next = add i64 %{name}.at, {step}")


def again(code: Vectors, name: str, end: str, then: str) -> None:
    """Emits the end of a loop, and the label `then`, where execution goes on when the counter has reached `end`, an i64."""
    code.lay(f"br label %{name}.end", f"{name}.end:", f"%{name}.more = icmp slt i64 %{name}.next, {end}",
             f"br i1 %{name}.more, label %{name}, label %{then}", f"{then}:")


def enter(code: Vectors, rays: RayVector, at: str, end: str | None) -> None:
    """Stores a vector of rays, in the form in which faces are tested, at the place `at` of the batch; `end`: their greatest
    t, None: infinite.
    """
    view, unit = view_along(code, rays)
    end = code.constant(INFINITY) if end is None else code.mul(end, unit)
    far = ZERO
    for axis, o in enumerate(view.o):
        centre, half = (code.splat(code.load(code.scalar, "%boxes", number), code.scalar) for number in (axis, axis + 3))
        far = code.greater(far, code.add(code.magnitude(code.sub(centre, o)), half))
    length = greatest(code, rays.d)
    over = [code.negated_where_negative(code.lesser(code.div(length, code.magnitude(component)),
                                                    code.number(STEEPEST)), component) for component in rays.d]
    values = (*view.o, *view.slopes, unit, *over, code.mul(far, code.number(WIDER)),
              code.choose(rays.valid, end, code.constant(DONE)))
    for name, value in zip(NUMBERS, values):
        code.store(code.numbers, value, code.at(code.scalar, f"%ray.{name}", at))
    code.store(code.integers, view.axis, code.at("i32", "%ray.axis", at))
    for name in ("prim", "ball"):
        code.store(code.integers, "splat (i32 -1)", code.at("i32", f"%ray.{name}", at))


def list_of_box(code: Vectors, name: str, number: str, before: str, count: str) -> None:
    """Emits the loop that lists the rays of the batch that meet a box, `%<name>.listed` of them; goes on at `<before>.end`
    if none does, else at `<before>.some`.

    Args:
        name: of the loop.
        number: of the box, i64.
        before: the name of the loop around it.
        count: rays of the batch.
    """
    box = code.at(code.scalar, "%boxes", code.line(f"mul i64 {number}, 6"))
    numbers = [code.splat(code.load(code.scalar, box, number), code.scalar) for number in range(6)]
    at = f"%{name}.at"
    loop(code, name, before, code.width, f"%{name}.found = phi i64 [ 0, %{before} ], [ %{name}.listed, %{name}.end ]")
    loaded = {column: code.line(f"load {code.numbers}, ptr {code.at(code.scalar, f'%ray.{column}', at)}")
              for column in ("x", "y", "z", "over_x", "over_y", "over_z", "margin", "end")}
    near, far = ZERO, loaded["end"]
    for axis, centre, half in zip("xyz", numbers[:3], numbers[3:]):
        over = loaded[f"over_{axis}"]
        middle = code.mul(code.sub(centre, loaded[axis]), over)
        reach = code.mul(code.add(half, loaded["margin"]), code.magnitude(over))
        near, far = code.greater(near, code.sub(middle, reach)), code.lesser(far, code.add(middle, reach))
    met = code.compare(near, "ole", far)
    packed = code.compressed(code.counted(at), met)
    code.lay(f"store {code.integers} {packed}, ptr {code.at('i32', '%list', f'%{name}.found')}, align 4",
             f"%{name}.listed = add i64 %{name}.found, {code.count(met)}")
    again(code, name, count, f"{name}.all")
    code.lay(f"%{name}.any = icmp sgt i64 %{name}.listed, 0",
             f"br i1 %{name}.any, label %{before}.some, label %{before}.end", f"{before}.some:")


def listed_rays(code: Vectors, listed: str, at: str) -> tuple[str, str]:
    """The vector of rays that begins at one entry of a list: flags of lanes within the list, and the rays' places in the
    batch, i32.
    """
    mask = lanes_before(code, listed, at)
    rays = code.line(f"load {code.integers}, ptr {code.at('i32', '%list', at)}, align 4")
    return mask, code.choose(mask, rays, ZERO, "i32")


def greatest(code: Vectors, vector: list[str]) -> str:
    """The greatest magnitude of the components of a vector."""
    x, y, z = map(code.magnitude, vector)
    return code.greater(code.greater(x, y), z)
