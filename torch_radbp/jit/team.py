"""Runs one compiled loop on all of torch's threads.

torch's OpenMP threads spin for a while after each parallel operation, and a second pool of threads would compete with
them for the cores: measured, that costs a query up to half of its speed. So the loop runs on those very threads.
GOMP_parallel is what a compiler makes of `#pragma omp parallel`, and it is looked up in the OpenMP runtime that torch
itself is linked to. Where that runtime does not have it (Windows, perhaps macOS) the loop runs on a pool of Python
threads.
"""

import ctypes
import functools
from array import array
from concurrent.futures import ThreadPoolExecutor

import torch

from torch_radbp.jit.torch_internals import library_of_torch

PART = 4096  # lanes that a thread takes at a time


class Job(ctypes.Structure):
    """A loop over lanes, of which threads take one part after the other."""

    _fields_ = [("lanes", ctypes.c_int64), ("part", ctypes.c_int64), ("next", ctypes.c_int64),
                ("inputs", ctypes.c_void_p), ("outputs", ctypes.c_void_p)]


LoopBody = ctypes.CFUNCTYPE(None, ctypes.c_void_p)


@functools.cache
def openmp_parallel():
    """GOMP_parallel(body, argument, number of threads, flags) of torch's own OpenMP runtime, or None."""
    # A symbol is looked up in a library and in all it depends on, hence in the runtime that torch loaded.
    function = getattr(library_of_torch(), "GOMP_parallel", None)
    if function is not None:
        function.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_uint, ctypes.c_uint]
        function.restype = None
    return function


@functools.cache
def thread_pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, thread_name_prefix="raycast")


def run(body: int, argument: int, threads: int) -> None:
    """Runs the C function `void body(void *argument)` on several threads at once and waits for all of them.

    Args:
        body: its address. It divides the work itself, and must be right on fewer threads than asked for, too: inside of
            another parallel region OpenMP gives one.
        argument: the address that every thread gets.
        threads: 1 is the calling thread alone.
    """
    if threads == 1:
        LoopBody(body)(argument)
    elif parallel := openmp_parallel():
        parallel(body, argument, threads, 0)
    else:
        calls = [thread_pool(threads).submit(LoopBody(body), argument) for _ in range(threads)]
        for call in calls:
            call.result()


def run_lanes(body: int, lanes: int, inputs: array, outputs: array, part: int = PART) -> None:
    """Runs the C function at `body`, which takes parts of a `Job`, on all of torch's threads.

    Args:
        body: its address.
        lanes: how many.
        inputs, outputs: arrays of 64-bit integers, the addresses of what it reads and writes.
        part: lanes that a thread takes at a time.
    """
    job = Job(lanes, part, 0, inputs.buffer_info()[0], outputs.buffer_info()[0])
    run(body, ctypes.addressof(job), threads=max(1, min(torch.get_num_threads(), -(-lanes // part))))
