"""Vectors of rays as packets of Embree's, as LLVM's text.

Packets of 8 are the fastest at every depth of a path: single rays are slower by a tenth to a half, packets of 4 by a few
hundredths, packets of 16 by a tenth to a fifth but for occlusion of camera rays; the flag for coherent rays changes nothing.
"""

from __future__ import annotations

from torch_radbp.raycast.queries import INFINITY, Kernel, Rays
from torch_radbp.raycast.vectors import ZERO, Vectors

WIDTH = 8  # rays in a packet

# Rows of RTCRayHit8 (rtcore_ray.h), each a vector of 32-bit words.
ORIGIN, TNEAR, DIRECTION, TFAR, MASK, NORMAL, U, V, PRIM_ID, GEOM_ID, ROWS = 0, 3, 4, 8, 9, 12, 15, 16, 17, 18, 21
NOTHING = "splat (i32 -1)"  # the geometry before any is hit; also: all bits of a mask set


def prepare(code: Vectors) -> None:
    """Lays a packet on the stack, aligned as Embree asks, with the rows that never change."""
    code.lay(f"%packet = alloca [{ROWS} x {code.integers}], align 64", f"%active = alloca {code.integers}, align 64")
    for number in range(ROWS):
        code.store(code.integers, NOTHING if number == MASK else ZERO, row(code, number))


def row(code: Vectors, number: int) -> str:
    """The address of a row of the packet."""
    return code.at(code.numbers, "%packet", number)


def cast(code: Vectors, rays: Rays, tfar: str) -> None:
    """Fills the packet and hands it to Embree; the rays end at `tfar`."""
    for first, components, harmless in ((ORIGIN, rays.o, ZERO), (DIRECTION, rays.d, code.constant("1.0"))):
        for number, component in enumerate(components, first):
            code.store(code.numbers, code.choose(rays.valid, component, harmless), row(code, number))
    code.store(code.numbers, tfar, row(code, TFAR))
    code.store(code.integers, NOTHING, row(code, GEOM_ID))
    code.store(code.integers, code.line(f"sext {code.flags} {rays.valid} to {code.integers}"), "%active")
    code.lay("call void %query(ptr %active, ptr %scene, ptr %packet, ptr null)")


def closest(code: Vectors, rays: Rays) -> tuple[str, str, str, str]:
    """prim, u, v and t of the closest hit, by rtcIntersect8."""
    cast(code, rays, code.constant(INFINITY))
    found = code.line(f"icmp ne {code.integers} {code.line(f'load {code.integers}, ptr {row(code, GEOM_ID)}')}, {NOTHING}")
    prim = code.choose(found, code.line(f"load {code.integers}, ptr {row(code, PRIM_ID)}"), NOTHING, "i32")
    numbers = [code.line(f"load {code.numbers}, ptr {row(code, number)}") for number in (U, V, TFAR)]
    return prim, *(code.choose(found, number, ZERO) for number in numbers)


def occluded(code: Vectors, rays: Rays, tmax: str) -> str:
    """Flags of rays with a triangle at 0 < t <= tmax, by rtcOccluded8, which then sets tfar to minus infinity."""
    cast(code, rays, tmax)
    return code.compare(code.line(f"load {code.numbers}, ptr {row(code, TFAR)}"), "olt", ZERO)


KERNEL = Kernel(("query", "scene"), prepare, closest, occluded)  # the function and the scene themselves, no columns
