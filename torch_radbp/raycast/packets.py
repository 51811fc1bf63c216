"""Vectors of rays as Embree's ray packets, as LLVM IR.

Embree follows a packet as a whole if it is told that its rays are coherent, and ray by ray otherwise. Camera rays are two to
three times as fast as a whole, rays after a diffuse bounce a third slower. So each packet is looked at: its rays are
coherent if they start and point nearly as the first one does. On an edge it would depend on the neighbours which of two
triangles is named; so the few rays that come upon one in company are asked for alone, and every answer is that of the ray by
itself. (Of triangles that coincide, neighbours may decide.)

Packets of 8 are the best for all: of incoherent rays, single ones are slower by a tenth to a half, packets of 4 by a few
hundredths, and packets of 16 by a tenth to a fifth.
"""

from __future__ import annotations

from torch_radbp.raycast.queries import INFINITY, CasterKernel, RayVector
from torch_radbp.raycast.vectors import ZERO, Vectors

WIDTH = 8  # rays in a packet

# Rows of RTCRayHit8 (rtcore_ray.h), each a vector of 32-bit words.
ORIGIN, TNEAR, DIRECTION, TFAR, MASK, NORMAL, U, V, PRIM_ID, GEOM_ID = 0, 3, 4, 8, 9, 12, 15, 16, 17, 18
INST_ID, INST_PRIM_ID, ROWS = 19, 20, 21
QUERY = "call void %query(ptr %active, ptr %scene, ptr %packet, ptr %arguments)"
COHERENT = 1 << 16  # RTC_RAY_QUERY_FLAG_COHERENT
NEAR = 0.05  # how far origins of coherent rays may differ, in units of the mesh's extent
# Powers of two, which LLVM's text holds exactly: by how much coherent directions may differ, relative to their length, and
# the weight of a corner so near the opposite edge that rounding decides.
ALIGNED, EDGE = 2.0**-3, 2.0**-20
NOTHING = "splat (i32 -1)"  # the geometry before any is hit; also: all bits of a mask set


def _prepare(code: Vectors) -> None:
    """Emits a packet on the stack, aligned as Embree requires, with the rows that never change."""
    code.lay(f"%packet = alloca [{ROWS} x {code.integers}], align 64", f"%active = alloca {code.integers}, align 64")
    for number in range(ROWS):
        code.store(code.integers, NOTHING if number == MASK else ZERO, row(code, number))
    # RTCIntersectArguments and RTCOccludedArguments: flags, feature mask (all), and functions and a context: none.
    code.lay("%arguments = alloca [6 x i64], align 8", f"store [6 x i64] {ZERO}, ptr %arguments")
    code.lay(f"store i32 -1, ptr {code.at('i32', '%arguments', 1)}", "%near = load float, ptr %near_at")


def row(code: Vectors, number: int) -> str:
    """The address of one field (a row of lanes) of the packet."""
    return code.at(code.numbers, "%packet", number)


def get(code: Vectors, number: int, kind: str = "float") -> str:
    """Loads one field of the packet, as floats unless `kind` is "i32"."""
    return code.line(f"load {code.vector(kind)}, ptr {row(code, number)}")


def cast(code: Vectors, rays: RayVector, tfar: str) -> str:
    """Emits the filling of a packet and the call of Embree; rays end at `tfar`. Returns an i1: they were traced as
    coherent.
    """
    for first, components, harmless in ((ORIGIN, rays.o, ZERO), (DIRECTION, rays.d, code.constant("1.0"))):
        for number, component in enumerate(components, first):
            code.store(code.numbers, code.choose(rays.valid, component, harmless), row(code, number))
    code.store(code.numbers, tfar, row(code, TFAR))
    code.store(code.integers, NOTHING, row(code, GEOM_ID))
    code.store(code.integers, code.line(f"sext {code.flags} {rays.valid} to {code.integers}"), "%active")
    together = coherent(code, rays)
    code.lay(f"store i32 {code.line(f'select i1 {together}, i32 {COHERENT}, i32 0')}, ptr %arguments", QUERY)
    return together


def coherent(code: Vectors, rays: RayVector) -> str:
    """An i1: all rays of the packet start near the first ray and point in about its direction."""
    apart, length = distance_from_first(code, rays.o)[0], code.splat("%near", "float")
    near = code.compare(apart, "ole", length)
    apart, length = distance_from_first(code, rays.d)
    aligned = code.compare(apart, "ole", code.mul(length, code.constant(repr(ALIGNED))))
    stray = code.both(rays.valid, code.neither(code.both(near, aligned), ZERO))
    return code.line(f"icmp eq i64 {code.bits(stray)}, 0")


def distance_from_first(code: Vectors, vector: list[str]) -> tuple[str, str]:
    """The difference of vectors from that of lane 0, and the sum of its magnitudes."""
    first = [code.line(f"shufflevector {code.numbers} {component}, {code.numbers} poison, {code.integers} {ZERO}")
             for component in vector]
    apart = [code.magnitude(code.sub(component, one)) for component, one in zip(vector, first)]
    length = [code.magnitude(one) for one in first]
    return tuple(code.add(code.add(*terms[:2]), terms[2]) for terms in (apart, length))


def closest(code: Vectors, rays: RayVector) -> tuple[str, str, str, str]:
    """prim, u, v and t of the closest hits, by rtcIntersect8."""
    together = cast(code, rays, code.constant(INFINITY))
    is_hit = code.line(f"icmp ne {code.integers} {get(code, GEOM_ID, 'i32')}, {NOTHING}")
    on_edge = code.both(is_hit, at_edge(code, get(code, U), get(code, V)))
    some = code.line(f"icmp ne i64 {code.bits(on_edge)}, 0")
    code.lay(f"%unsure = and i1 {together}, {some}", "br i1 %unsure, label %alone, label %sure", "alone:")
    code.store(code.numbers, code.choose(on_edge, code.constant(INFINITY), get(code, TFAR)), row(code, TFAR))
    code.store(code.integers, code.choose(on_edge, NOTHING, get(code, GEOM_ID, "i32"), "i32"), row(code, GEOM_ID))
    code.store(code.integers, code.line(f"sext {code.flags} {on_edge} to {code.integers}"), "%active")
    code.lay("store i32 0, ptr %arguments", QUERY, "br label %sure", "sure:")
    is_hit = code.line(f"icmp ne {code.integers} {get(code, GEOM_ID, 'i32')}, {NOTHING}")
    prim = code.choose(is_hit, get(code, PRIM_ID, "i32"), NOTHING, "i32")
    return prim, *(code.choose(is_hit, get(code, number), ZERO) for number in (U, V, TFAR))


def at_edge(code: Vectors, u: str, v: str) -> str:
    """Flags of hits so near an edge that Embree, which allows for rounding, may report them on both of its sides."""
    w = code.sub(code.sub(code.constant("1.0"), u), v)
    first, second, third = (code.compare(weight, "ole", code.constant(repr(EDGE))) for weight in (u, v, w))
    return code.either(code.either(first, second), third)


def occluded(code: Vectors, rays: RayVector, tmax: str) -> str:
    """Flags of rays with a triangle at 0 < t <= tmax, by rtcOccluded8, which then sets tfar to minus infinity."""
    cast(code, rays, tmax)
    return code.compare(get(code, TFAR), "olt", ZERO)


def closest_of_instances(code: Vectors, rays: RayVector) -> tuple[str, str, str, str, str]:
    """prim, u, v and t of the closest hits in a scene with instances, and the number of the instance.

    Embree counts both anew in each of its geometries: what comes before is read from two tables, first that of the
    triangles that no instance shows, whose geometry Embree calls -1.
    """
    prim, *place = closest(code, rays)
    is_hit = code.line(f"icmp sge {code.integers} {prim}, {ZERO}")
    geometry = code.line(f"sub {code.integers} {get(code, INST_ID, 'i32')}, {NOTHING}")
    before, first = (code.gather("i32", table, geometry, is_hit) for table in ("%first_triangles", "%first_instances"))
    prim = code.choose(is_hit, code.line(f"add {code.integers} {prim}, {before}"), prim, "i32")
    instance = code.line(f"add {code.integers} {get(code, INST_PRIM_ID, 'i32')}, {first}")
    return prim, *place, code.choose(is_hit, instance, ZERO, "i32")


# Embree's function and scene, and the address of the distance within which origins are near.
KERNEL = CasterKernel(("query", "scene", "near_at"), _prepare, closest, occluded)
OF_INSTANCES = CasterKernel((*KERNEL.inputs, "first_triangles", "first_instances"), _prepare, closest_of_instances, occluded,
                            True)
