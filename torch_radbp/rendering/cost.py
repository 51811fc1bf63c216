"""Predicts the least cost of a call before its first ray; raises if no machine could do it."""

from __future__ import annotations

import functools
import os
from typing import NamedTuple

import torch

from torch_radbp.adjoint.strategy import AdjointStrategy
from torch_radbp.rendering.memory import LEAST_BOUNCE, Workload, bytes_text, predict

MOST_NUMBERED = 2**31 - 1  # pixels of an image, samples of a pixel: int32 counts them
MOST_PATHS = 10**12  # a day at 10 million paths a second, hours on the fastest devices of today
RETURNED_COPIES = 2  # of each image: the sums of its chunks, and what is returned
CHUNK_BYTES = 200  # of the list of chunks, each
LANES = {True: 1 << 18, False: 1 << 17}  # of a chunk on the CPU if the user does not say, about; compiled and eager
LANES_IN_MEDIA = 1 << 16  # the same where there are media, in which a path carries more, and its derivative a side path
# On a GPU the host takes milliseconds to start a bounce of whatever size, so chunks are as large as its memory allows.
LANES_ON_GPU = (1 << 18, 1 << 24)  # the fewest and the most of a chunk, about
BYTES_ON_GPU = {True: 4096, False: 16384}  # of its memory for each lane of float32; compiled and eager
RECORDS_OF_CHUNK = 112 << 20  # bytes, on the CPU if the user does not say
LONGEST_TAIL = 20  # bounces after roulette has begun, in the mean of paths that survive as often as it lets them
SHARE_OF_RECORDS = 1 / 8  # of all memory


class Request(NamedTuple):
    """The size of a call, for predictions of its cost."""

    images: int
    width: int  # pixels
    height: int
    spp: int
    chunk: int | None  # lanes traced together; None: not planned yet
    max_depth: int
    dtype: torch.dtype
    device: torch.device
    workers: int  # chunks that are traced side by side
    adjoint: AdjointStrategy | None  # of the backward pass, unless a memory budget is set
    record_bytes: float  # see `RenderCall`; 0: image and derivative have different samples
    compiled: bool
    media: bool = False  # the scene has some

    @property
    def paths(self) -> int:
        return self.images * self.width * self.height * self.spp

    @property
    def least_bytes(self) -> int:
        """The least memory of a call: as if every path ended after its first bounce."""
        images = RETURNED_COPIES * 3 * self.images * self.width * self.height * self.dtype.itemsize
        together = min(self.paths, self.workers * self.chunk)
        working = together * LEAST_BOUNCE * self.dtype.itemsize
        if self.adjoint is not None:
            work = Workload([1.0], self.paths, self.max_depth, self.dtype, self.compiled, self.workers)
            working = max(working, predict(work, self.chunk, self.adjoint, self.record_bytes).peak)
        return images + working + CHUNK_BYTES * -(-self.paths // self.chunk)

    def __str__(self) -> str:
        return f"{self.images} image{'s' * (self.images > 1)} of {self.width} x {self.height} pixels with spp={self.spp}"


def lanes_of_chunks(device: torch.device, dtype: torch.dtype, workers: int, compiled: bool, media: bool = False) -> int:
    """The default number of lanes of a chunk."""
    if device.type != "cuda":
        return LANES_IN_MEDIA if media else LANES[compiled or workers == 1]
    fewest, most = LANES_ON_GPU
    return int(max(fewest, min(most, memory_of(device) / (BYTES_ON_GPU[compiled] * dtype.itemsize / 4))))


@functools.lru_cache
def recorded_lanes(adjoint, max_depth: int, rr_depth: int, dtype: torch.dtype) -> int:
    """The default lanes of a CPU chunk, by the memory for records of paths of expected length."""
    bounces = max(1, min(max_depth, rr_depth + LONGEST_TAIL))
    return RECORDS_OF_CHUNK // max(1, predict(Workload([1.0] * bounces, 1, max_depth, dtype), 1, adjoint).kept)


def traced_together(adjoint, lanes: int, max_depth: int, rr_depth: int, dtype: torch.dtype) -> bool:
    """True if the samples of an image and of its derivative are so few that they are traced as one wavefront.

    A wavefront of some thousand lanes takes as long as one of half as many, most of it in Python. The records of all are
    kept until the backward pass, so they must fit what is kept of a chunk, and no step may have to be taken again.

    Args:
        adjoint: the strategy.
        lanes: of the image.
        max_depth, rr_depth, dtype: of the rendering.
    """
    return adjoint.records_all and 2 * lanes <= recorded_lanes(adjoint, max_depth, rr_depth, dtype)


def bytes_of_records(device: torch.device) -> float:
    """The default limit of bytes, on a device, for path records between forward and backward pass."""
    return SHARE_OF_RECORDS * memory_of(device)


def check_cost(request: Request) -> None:
    """Raises ValueError for calls that no machine traces in a day, or that cannot fit this machine's memory.

    Raises:
        ValueError: with the number of paths, or the bytes that are needed at least and those that there are.
    """
    if request.paths > MOST_PATHS or request.spp > MOST_NUMBERED or request.width * request.height > MOST_NUMBERED:
        raise ValueError(f"{request}: {request.paths:.3g} paths, and {bytes_text(request.least_bytes)} of memory at least; "
                         f"one call traces at most {MOST_PATHS:.0e} paths, {MOST_NUMBERED} pixels of an image and as many "
                         f"samples of a pixel: average calls of fewer samples with other seeds, or render crops of the film")
    there = memory_of(request.device)
    if request.least_bytes > there:
        remedy = "set memory_budget, or average the gradients of calls of fewer samples with other seeds, or "
        raise ValueError(f"{request}: {bytes_text(request.least_bytes)} of memory at least, and there are "
                         f"{bytes_text(there)}; {'' if request.adjoint is None else remedy}choose a smaller film, chunk or "
                         "spp")


def memory_of(device: torch.device) -> float:
    """Total bytes of a device's memory; infinite if unknown. Processes under torchrun share the host's."""
    if device.type == "cuda":
        return torch.cuda.get_device_properties(device).total_memory
    if device.type != "cpu" or "SC_PHYS_PAGES" not in getattr(os, "sysconf_names", ()):
        return float("inf")
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / int(os.environ.get("LOCAL_WORLD_SIZE", "1"))
