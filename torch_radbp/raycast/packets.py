"""The loops that feed lanes to Embree in packets, compiled by numba to plain C functions.

A query is described by one `JOB` record, and `closest_hit` and `any_hit` take its address. Any number of threads may run them
on one record at once, because each takes its next block of lanes from the record's atomic counter. They touch no Python
object and need no interpreter lock, so they run on OpenMP's threads as well as on Python's (see `team.py`).
"""

import numba
import numpy as np
from llvmlite import ir
from numba import carray
from numba.core import types
from numba.extending import intrinsic

# Rays per packet; rtcIntersect8, not 16: see benchmarks/raycast.py.
WIDTH = 8
# Lanes that a thread takes at a time: few enough to keep all threads busy to the end, enough to leave the counter alone.
BLOCK = 1024

# Rows of Embree's RTCRayHitN (rtcore_ray.h), a struct of arrays: one row of WIDTH words per field.
ORIGIN_X, ORIGIN_Y, ORIGIN_Z, TNEAR, DIRECTION_X, DIRECTION_Y, DIRECTION_Z, TIME, TFAR, MASK, RAY_ID, FLAGS = range(12)
NORMAL_X, NORMAL_Y, NORMAL_Z, HIT_U, HIT_V, PRIM_ID, GEOM_ID, INSTANCE_ID, INSTANCE_PRIM_ID = range(12, 21)
# A row of our own for Embree's separate array of lane masks: -1 for a ray, 0 for an empty slot.
VALID = 21
LANE = 22
ROWS = 23

# What one query reads and writes. Every field is an int64: a count, or the address of one array of `lanes` elements.
JOB = np.dtype(
    [
        (name, np.int64)
        for name in (
            *("query", "scene"),  # address of rtcIntersect8 or rtcOccluded8, RTCScene
            *("lanes", "next_lane"),  # count; address of the int64 counter
            *("ox", "oy", "oz", "dx", "dy", "dz", "tmax"),  # float32; tmax for any_hit only
            *("prim", "u", "v"),  # int32, float32, float32: closest_hit's result
            "hidden",  # bool: any_hit's result
        )
    ]
)
JobPointer = types.CPointer(numba.from_dtype(JOB))


def compiled(function):
    """`function` as C code that takes a job pointer; kept on disk if numba finds a place that it may write to."""
    try:
        return numba.cfunc(types.void(JobPointer), cache=True)(function)
    except RuntimeError:  # "no locator available": a read-only installation without a writable user cache
        return numba.cfunc(types.void(JobPointer))(function)


@intrinsic
def pointer(typing_context, address):
    """The address as a pointer that `carray` takes."""

    def generate(context, builder, signature, arguments):
        return builder.inttoptr(arguments[0], context.get_value_type(types.voidptr))

    return types.voidptr(types.int64), generate


@intrinsic
def call_embree(typing_context, query, valid, scene, packet):
    """Calls rtcIntersectN or rtcOccludedN by its address: numba can cache that, but not a ctypes function."""

    def generate(context, builder, signature, arguments):
        byte_pointer = ir.IntType(8).as_pointer()
        prototype = ir.FunctionType(ir.VoidType(), [byte_pointer] * 4)
        function = builder.inttoptr(arguments[0], prototype.as_pointer())
        no_arguments = ir.Constant(byte_pointer, None)  # RTCIntersectArguments*: the defaults
        builder.call(function, [builder.inttoptr(a, byte_pointer) for a in arguments[1:]] + [no_arguments])
        return context.get_dummy_value()

    return types.void(types.int64, types.int64, types.int64, types.int64), generate


@intrinsic
def atomic_add(typing_context, address, amount):
    """Adds to the int64 at `address` and returns what was there before."""

    def generate(context, builder, signature, arguments):
        target = builder.inttoptr(arguments[0], ir.IntType(64).as_pointer())
        return builder.atomic_rmw("add", target, arguments[1], "monotonic")

    return types.int64(types.int64, types.int64), generate


@intrinsic
def stack_packet(typing_context):
    """The address of a packet on the stack of the calling compiled function, aligned as Embree asks."""

    def generate(context, builder, signature, arguments):
        with builder.goto_entry_block():
            packet = builder.alloca(ir.ArrayType(ir.IntType(32), ROWS * WIDTH))
            packet.align = 64
        return builder.ptrtoint(packet, ir.IntType(64))

    return types.int64(), generate


@numba.njit
def lanes_of(address, count):
    """The float32 array at `address`."""
    return carray(pointer(address), count, np.float32)


@numba.njit
def is_ray(ox, oy, oz, dx, dy, dz):
    """False for a lane that is not finite, which would spoil its whole packet, and for one without a direction."""
    finite = 0 * ox + 0 * oy + 0 * oz + 0 * dx + 0 * dy + 0 * dz == 0
    return finite and not (dx == 0 and dy == 0 and dz == 0)


@numba.njit
def clear(packet, words):
    """Makes every slot empty and without a hit."""
    words[VALID] = 0
    words[GEOM_ID] = -1
    packet[TFAR] = np.inf


@compiled
def closest_hit(job_pointer):
    """Writes prim (-1 on a miss), u and v of the closest hit of every lane."""
    job = carray(job_pointer, 1)[0]
    n = job.lanes
    ox, oy, oz = lanes_of(job.ox, n), lanes_of(job.oy, n), lanes_of(job.oz, n)
    dx, dy, dz = lanes_of(job.dx, n), lanes_of(job.dy, n), lanes_of(job.dz, n)
    prim, u, v = carray(pointer(job.prim), n, np.int32), lanes_of(job.u, n), lanes_of(job.v, n)

    address = stack_packet()
    packet = carray(pointer(address), (ROWS, WIDTH), np.float32)
    words = carray(pointer(address), (ROWS, WIDTH), np.int32)
    words[:] = 0
    words[MASK] = -1
    clear(packet, words)
    while True:
        start = atomic_add(job.next_lane, BLOCK)
        if start >= n:
            break
        stop = min(n, start + BLOCK)
        filled = 0
        for lane in range(start, stop):
            if is_ray(ox[lane], oy[lane], oz[lane], dx[lane], dy[lane], dz[lane]):
                packet[ORIGIN_X, filled], packet[ORIGIN_Y, filled], packet[ORIGIN_Z, filled] = ox[lane], oy[lane], oz[lane]
                packet[DIRECTION_X, filled], packet[DIRECTION_Y, filled], packet[DIRECTION_Z, filled] = dx[lane], dy[lane], dz[lane]
                words[VALID, filled] = -1
                words[LANE, filled] = lane
                filled += 1
            else:
                prim[lane], u[lane], v[lane] = -1, 0, 0
            if filled == WIDTH or (lane == stop - 1 and filled > 0):
                call_embree(job.query, address + VALID * WIDTH * 4, job.scene, address)
                for slot in range(filled):
                    hit = words[LANE, slot]
                    if words[GEOM_ID, slot] == -1:
                        prim[hit], u[hit], v[hit] = -1, 0, 0
                    else:
                        prim[hit], u[hit], v[hit] = words[PRIM_ID, slot], packet[HIT_U, slot], packet[HIT_V, slot]
                clear(packet, words)
                filled = 0


@compiled
def any_hit(job_pointer):
    """Writes whether anything lies between 0 and tmax on every lane; tmax <= 0 is no query, and False."""
    job = carray(job_pointer, 1)[0]
    n = job.lanes
    ox, oy, oz = lanes_of(job.ox, n), lanes_of(job.oy, n), lanes_of(job.oz, n)
    dx, dy, dz = lanes_of(job.dx, n), lanes_of(job.dy, n), lanes_of(job.dz, n)
    tmax, hidden = lanes_of(job.tmax, n), carray(pointer(job.hidden), n, np.uint8)

    address = stack_packet()
    packet = carray(pointer(address), (ROWS, WIDTH), np.float32)
    words = carray(pointer(address), (ROWS, WIDTH), np.int32)
    words[:] = 0
    words[MASK] = -1
    while True:
        start = atomic_add(job.next_lane, BLOCK)
        if start >= n:
            break
        stop = min(n, start + BLOCK)
        filled = 0
        for lane in range(start, stop):
            hidden[lane] = 0
            if tmax[lane] > 0 and is_ray(ox[lane], oy[lane], oz[lane], dx[lane], dy[lane], dz[lane]):
                packet[ORIGIN_X, filled], packet[ORIGIN_Y, filled], packet[ORIGIN_Z, filled] = ox[lane], oy[lane], oz[lane]
                packet[DIRECTION_X, filled], packet[DIRECTION_Y, filled], packet[DIRECTION_Z, filled] = dx[lane], dy[lane], dz[lane]
                packet[TFAR, filled] = tmax[lane]
                words[VALID, filled] = -1
                words[LANE, filled] = lane
                filled += 1
            if filled == WIDTH or (lane == stop - 1 and filled > 0):
                call_embree(job.query, address + VALID * WIDTH * 4, job.scene, address)
                for slot in range(filled):
                    hidden[words[LANE, slot]] = packet[TFAR, slot] < 0  # Embree's answer: tfar = -inf
                words[VALID] = 0
                filled = 0
