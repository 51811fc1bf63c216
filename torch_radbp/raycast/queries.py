"""The closest-hit and the occlusion loop over lanes, as LLVM IR, around a kernel that casts one vector of rays."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from torch_radbp.raycast.vectors import ZERO, Vectors

INFINITY = "0x7FF0000000000000"


class RayVector(NamedTuple):
    """A vector of rays in LLVM IR: the names of their components, and flags of the lanes that are valid rays."""

    o: list[str]
    d: list[str]
    valid: str  # flags: finite, with a direction, and active; other lanes have no meaning


class CasterKernel(NamedTuple):
    """The functions of a ray caster by which the loops emit IR that casts one vector of rays, after the label `cast`."""

    inputs: tuple[str, ...]  # names of the addresses that follow the columns of lanes
    prepare: Callable[[Vectors], None]  # what comes before the loop
    # prim (i32, -1 on a miss), u, v and t (0 on a miss); and where there are instances, which (i32, 0 on a miss).
    closest: Callable[[Vectors, RayVector], tuple[str, ...]]
    occluded: Callable[[Vectors, RayVector, str], str]  # with tmax > 0: flags
    instances: bool = False


def _begin(code: Vectors, kernel: CasterKernel, columns: int, outputs: int) -> list[str]:
    """Emits the head of a loop and returns the addresses of the inputs of each lane; the outputs are `%out0`, ..."""
    code.lay("entry:")
    for number in range(outputs):
        code.lay(f"%out{number} = load ptr, ptr {code.at('ptr', '%outputs', number)}")
    for number, name in enumerate(kernel.inputs, columns):
        code.lay(f"%{name} = load ptr, ptr {code.at('ptr', '%inputs', number)}")
    kernel.prepare(code)
    return [code.load("ptr", "%inputs", number) for number in range(columns)]


def lanes_before(code: Vectors, end: str, at: str) -> str:
    """Flags of lanes of the vector that starts at index `at` which come before `end`; both i64."""
    left = code.splat(code.line(f"sub i64 {end}, {at}"), "i64")
    return code.line(f"icmp slt {code.vector('i64')} {code.steps('i64')}, {left}")


def rays_among_lanes(code: Vectors, columns: list[str], mask: str) -> RayVector:
    """Loads a vector of rays from columns of lanes; rays that are not finite, or have no direction, are not valid."""
    o, d = columns[:3], columns[3:]
    zero_if_finite = ZERO
    for column in columns:
        zero_if_finite = code.add(zero_if_finite, code.line(f"fmul {code.numbers} {column}, {ZERO}"))
    moving = code.either(code.either(code.compare(d[0], "one", ZERO), code.compare(d[1], "one", ZERO)),
                         code.compare(d[2], "one", ZERO))
    return RayVector(o, d, code.both(mask, code.both(code.compare(zero_if_finite, "oeq", ZERO), moving)))


def closest_hit_of_packets(code: Vectors, kernel: CasterKernel) -> str:
    """The LLVM IR of the closest-hit loop: prim, u, v and t of every lane, and the instance if there are any."""
    kinds = ("i32", *[code.scalar] * 3, *["i32"] * kernel.instances)
    columns = _begin(code, kernel, columns=6, outputs=len(kinds))
    code.lay("br label %cast\ncast:\n%at = phi i64 [ %first, %entry ], [ %at.next, %answered ]")
    mask = lanes_before(code, "%last", "%at")
    rays = rays_among_lanes(code, [code.load_where(mask, column, "%at") for column in columns], mask)
    answers = kernel.closest(code, rays)
    for number, (kind, answer) in enumerate(zip(kinds, answers, strict=True)):
        code.store_where(mask, kind, answer, f"%out{number}", "%at")
    code.lay("br label %answered", "answered:",
             f"%at.next = add i64 %at, {code.width}", "%at.more = icmp slt i64 %at.next, %last",
             "br i1 %at.more, label %cast, label %done", "done:", "ret void")
    return code.text()


def write_hidden(code: Vectors, hidden: str, lanes: str, then: str) -> None:
    """Emits the loop that writes 1 into `%hidden` at lanes whose flags are set, and then the label `then`.

    Args:
        hidden: the flags.
        lanes: the address of the numbers of the lanes, i32.
    """
    bits = code.bits(hidden)
    code.lay("br label %answered", "answered:", f"%any = icmp ne i64 {bits}, 0", f"br i1 %any, label %set, label %{then}",
             "set:", f"%bits = phi i64 [ {bits}, %answered ], [ %bits.next, %set ]")
    first = code.call("llvm.cttz.i64", "i64", ("i64", "%bits"), ("i1", "true"))
    lane = code.line(f"zext i32 {code.load('i32', lanes, first)} to i64")
    code.lay(f"store i8 1, ptr {code.at('i8', '%hidden', lane)}",
             "%lower = sub i64 %bits, 1", "%bits.next = and i64 %bits, %lower", "%bits.more = icmp ne i64 %bits.next, 0",
             f"br i1 %bits.more, label %set, label %{then}", f"{then}:")


def any_hit_of_packets(code: Vectors, kernel: CasterKernel) -> str:
    """The LLVM IR of the occlusion loop: 1 in every lane with a triangle at 0 < t <= tmax, else 0, as bytes.

    Lanes without a segment cost next to nothing: the others queue up until they fill a vector.
    """
    width = code.width
    columns = [code.at(code.scalar, column, "%first") for column in _begin(code, kernel, columns=7, outputs=1)]
    code.lay("%hidden = getelementptr i8, ptr %out0, i64 %first", "%lanes = sub i64 %last, %first",
             f"%queue = alloca i32, i64 {3 * width}", "br label %fill")

    # Queue the lanes that have a segment.
    code.lay("fill:", "%at = phi i64 [ 0, %entry ], [ %at.next, %next ]",
             "%waiting = phi i64 [ 0, %entry ], [ %length, %next ]")
    mask = lanes_before(code, "%lanes", "%at")
    segment = code.both(mask, code.compare(code.load_where(mask, columns[6], "%at"), "ogt", ZERO))
    code.store_where(mask, "i8", ZERO, "%hidden", "%at")
    lanes = code.compressed(code.counted("%at"), segment)
    code.lay(f"store {code.integers} {lanes}, ptr {code.at('i32', '%queue', '%waiting')}, align 4")
    queued = code.line(f"add i64 %waiting, {code.count(segment)}")
    code.lay(f"%at.next = add i64 %at, {width}", "%at.more = icmp slt i64 %at.next, %lanes", "br label %decide")

    # Cast a full vector, and in the end what is left.
    code.lay("decide:", f"%length = phi i64 [ {queued}, %fill ], [ %rest, %shift ]",
             f"%full = icmp sge i64 %length, {width}", "%some = icmp sgt i64 %length, 0",
             "%due = select i1 %at.more, i1 %full, i1 %some", "br i1 %due, label %cast, label %next",
             "next:", "br i1 %at.more, label %fill, label %done", "done:", "ret void", "cast:")
    mask = lanes_before(code, "%length", "0")
    queue = code.line(f"load {code.integers}, ptr %queue, align 4")
    rays = [code.gather(code.scalar, column, queue, mask) for column in columns]
    hidden = kernel.occluded(code, rays_among_lanes(code, rays[:6], mask), rays[6])

    # Only lanes that are hidden have to be written.
    write_hidden(code, hidden, "%queue", "shift")
    behind = code.line(f"load {code.integers}, ptr {code.at('i32', '%queue', width)}, align 4")
    left = code.call("llvm.smax.i64", "i64", ("i64", code.line(f"sub i64 %length, {width}")), ("i64", "0"))
    code.lay(f"store {code.integers} {behind}, ptr %queue, align 4", f"%rest = add i64 {left}, 0", "br label %decide")
    return code.text()
