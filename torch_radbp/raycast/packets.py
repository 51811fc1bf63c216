"""The loops that feed lanes to Embree in packets, compiled by numba to plain C functions.

A query is described by one `JOB` record, and `closest_hit` and `any_hit` take its address. Any number of threads may
run them on one record at once, because each takes its next block of lanes from a shared atomic counter. They touch no
Python object and need no interpreter lock, so they run on OpenMP's threads as well as on Python's (see `jit/team.py`).
"""

import numba
import numpy as np
from llvmlite import ir
from numba import carray, float32, int32, uint8
from numba.core import types
from numba.extending import intrinsic

# Rays per packet. Packets of 16 on AVX-512 were faster only for any hit of camera rays, and up to a fifth slower
# for any hit of incoherent rays, which is what a path tracer asks most.
WIDTH = 8
# Lanes that a thread takes at a time: few enough to keep all threads busy to the end.
BLOCK = 1024

# Rows of Embree's RTCRayHitN (rtcore_ray.h), a struct of arrays: one row of WIDTH 32-bit words per field.
ORIGIN_X, ORIGIN_Y, ORIGIN_Z, TNEAR, DIRECTION_X, DIRECTION_Y, DIRECTION_Z, TIME, TFAR, MASK, RAY_ID, FLAGS = range(12)
NORMAL_X, NORMAL_Y, NORMAL_Z, HIT_U, HIT_V, PRIM_ID, GEOM_ID, INSTANCE_ID, INSTANCE_PRIM_ID = range(12, 21)
# Rows of our own: Embree's separate array of slot masks (-1 for a ray, 0 for an empty slot), and the lane of each slot.
VALID, LANE = 21, 22
ROWS = 23

# What one query reads and writes. All fields are int64: the number of lanes, and addresses.
JOB_FIELDS = (
    *("query", "scene"),  # rtcIntersect8 or rtcOccluded8, RTCScene
    *("lanes", "next_lane"),  # next_lane: of the int64 counter that the threads share, 0 at first
    *("ox", "oy", "oz", "dx", "dy", "dz", "tmax"),  # float32 per lane; tmax for any_hit only
    *("prim", "u", "v", "t"),  # int32 and float32 per lane: what closest_hit writes
    "hidden",  # bool per lane: what any_hit writes
)
JOB = np.dtype([(name, np.int64) for name in JOB_FIELDS])
JobPointer = types.CPointer(numba.from_dtype(JOB))


def compiled(function):
    """`function` as C code that takes a job's address, kept on disk if numba finds a place that it may write to."""
    try:
        return numba.cfunc(types.void(JobPointer), cache=True)(function)
    except RuntimeError:  # "no locator available": a read-only installation without a writable user cache
        return numba.cfunc(types.void(JobPointer))(function)


@intrinsic
def pointer(typing_context, address):
    """The int64 `address` as a pointer that `carray` takes."""

    def generate(context, builder, signature, arguments):
        return builder.inttoptr(arguments[0], context.get_value_type(types.voidptr))

    return types.voidptr(types.int64), generate


@intrinsic
def stack_packet(typing_context):
    """The address of a packet on the stack of the calling C function, aligned as Embree asks."""

    def generate(context, builder, signature, arguments):
        with builder.goto_entry_block():
            packet = builder.alloca(ir.ArrayType(ir.IntType(32), ROWS * WIDTH))
            packet.align = 64
        return builder.ptrtoint(packet, ir.IntType(64))

    return types.int64(), generate


@intrinsic
def call_embree(typing_context, query, valid, scene, packet):
    """Calls rtcIntersectN or rtcOccludedN by its address: numba can cache that, but not a ctypes function."""

    def generate(context, builder, signature, arguments):
        byte_pointer = ir.IntType(8).as_pointer()
        prototype = ir.FunctionType(ir.VoidType(), [byte_pointer] * 4)
        function = builder.inttoptr(arguments[0], prototype.as_pointer())
        defaults = ir.Constant(byte_pointer, None)  # no RTCIntersectArguments
        builder.call(function, [builder.inttoptr(a, byte_pointer) for a in arguments[1:]] + [defaults])
        return context.get_dummy_value()

    return types.void(types.int64, types.int64, types.int64, types.int64), generate


@intrinsic
def atomic_add(typing_context, address, amount):
    """Adds to the int64 at `address` and returns what was there before."""

    def generate(context, builder, signature, arguments):
        target = builder.inttoptr(arguments[0], ir.IntType(64).as_pointer())
        return builder.atomic_rmw("add", target, arguments[1], "monotonic")

    return types.int64(types.int64, types.int64), generate


@numba.njit(forceinline=True)
def rays_of(job):
    """Origins and directions: ox, oy, oz, dx, dy, dz."""
    n = job.lanes
    return (
        carray(pointer(job.ox), n, float32),
        carray(pointer(job.oy), n, float32),
        carray(pointer(job.oz), n, float32),
        carray(pointer(job.dx), n, float32),
        carray(pointer(job.dy), n, float32),
        carray(pointer(job.dz), n, float32),
    )


@numba.njit(forceinline=True)
def is_ray(rays, lane):
    """False for a lane that is not finite, which would spoil its whole packet, and for one without a direction."""
    ox, oy, oz, dx, dy, dz = rays
    zero_if_finite = 0 * ox[lane] + 0 * oy[lane] + 0 * oz[lane] + 0 * dx[lane] + 0 * dy[lane] + 0 * dz[lane]
    return zero_if_finite == 0 and (dx[lane] != 0 or dy[lane] != 0 or dz[lane] != 0)


@numba.njit(forceinline=True)
def as_packet(address):
    """Views of the packet as float32 and as int32, (ROWS, WIDTH), with constant rows set and all slots empty."""
    packet = carray(pointer(address), (ROWS, WIDTH), float32)
    words = carray(pointer(address), (ROWS, WIDTH), int32)
    words[:] = 0
    words[MASK] = -1
    return packet, words


@numba.njit(forceinline=True)
def put_ray(packet, words, slot, rays, lane, tfar):
    """Fills an empty slot with the ray of a lane and no hit; the ray ends at tfar."""
    ox, oy, oz, dx, dy, dz = rays
    packet[ORIGIN_X, slot] = ox[lane]
    packet[ORIGIN_Y, slot] = oy[lane]
    packet[ORIGIN_Z, slot] = oz[lane]
    packet[DIRECTION_X, slot] = dx[lane]
    packet[DIRECTION_Y, slot] = dy[lane]
    packet[DIRECTION_Z, slot] = dz[lane]
    packet[TFAR, slot] = tfar
    words[GEOM_ID, slot] = -1
    words[VALID, slot] = -1
    words[LANE, slot] = lane


@numba.njit(forceinline=True)
def cast(job, columns, begin, answer):
    """Takes blocks of lanes and casts their rays in packets until no lane is left.

    Args:
        job: the record of the query.
        columns: what the two functions read and write, a tuple of arrays with an entry per lane.
        begin: (columns, lane) -> tfar; gives the lane the answer of a ray that meets nothing, and says where its ray ends;
            a lane whose ray ends at 0 or before keeps that answer.
        answer: (columns, packet, words, filled) -> None; hands the answers of the first `filled` slots to their lanes. It
            loops itself: called slot by slot, it cost any_hit a tenth of its speed.
    """
    rays = rays_of(job)
    address = stack_packet()
    packet, words = as_packet(address)
    start = atomic_add(job.next_lane, BLOCK)
    while start < job.lanes:
        stop = min(job.lanes, start + BLOCK)
        filled = 0
        for lane in range(start, stop):
            tfar = begin(columns, lane)
            if tfar > 0 and is_ray(rays, lane):
                put_ray(packet, words, filled, rays, lane, tfar)
                filled += 1
            # Cast a full packet, or what the block leaves.
            if filled == WIDTH or (filled > 0 and lane == stop - 1):
                call_embree(job.query, address + VALID * WIDTH * 4, job.scene, address)
                answer(columns, packet, words, filled)
                words[VALID] = 0
                filled = 0
        start = atomic_add(job.next_lane, BLOCK)


@numba.njit(forceinline=True)
def begin_closest(columns, lane):
    prim, u, v, t = columns
    prim[lane], u[lane], v[lane], t[lane] = -1, 0, 0, 0
    return np.inf


@numba.njit(forceinline=True)
def answer_closest(columns, packet, words, filled):
    prim, u, v, t = columns
    for slot in range(filled):
        if words[GEOM_ID, slot] != -1:
            lane = words[LANE, slot]
            prim[lane], t[lane] = words[PRIM_ID, slot], packet[TFAR, slot]
            u[lane], v[lane] = packet[HIT_U, slot], packet[HIT_V, slot]


@numba.njit(forceinline=True)
def begin_any(columns, lane):
    tmax, hidden = columns
    hidden[lane] = 0
    return tmax[lane]


@numba.njit(forceinline=True)
def answer_any(columns, packet, words, filled):
    tmax, hidden = columns
    for slot in range(filled):
        hidden[words[LANE, slot]] = packet[TFAR, slot] < 0  # Embree's answer: tfar = -inf


@compiled
def closest_hit(job_address):
    """Writes prim (-1 on a miss), u, v and t of the closest hit of every lane."""
    job = carray(job_address, 1)[0]
    n = job.lanes
    prim = carray(pointer(job.prim), n, int32)
    u, v, t = carray(pointer(job.u), n, float32), carray(pointer(job.v), n, float32), carray(pointer(job.t), n, float32)
    cast(job, (prim, u, v, t), begin_closest, answer_closest)


@compiled
def any_hit(job_address):
    """Writes whether anything lies between 0 and tmax on every lane; tmax <= 0 is no query, and False."""
    job = carray(job_address, 1)[0]
    columns = carray(pointer(job.tmax), job.lanes, float32), carray(pointer(job.hidden), job.lanes, uint8)
    cast(job, columns, begin_any, answer_any)
