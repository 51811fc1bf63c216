"""Chunks: the blocks of lanes that are traced together, and how they are dealt out to workers.

Which part of an image is dear is not known before: the sky costs one bounce, a mesh below it six. So chunks do not each take
a part of the image, but all take runs of neighbouring pixels in turn: workers finish together, and what one chunk needs,
all need.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import torch
from torch import Tensor

RUN = 16  # pixels: their rays are coherent, and a row of an image has many such runs
LEAST_LANES = 1 << 15  # of a chunk if the user does not say: below, a second one costs more in Python than it gains


class Pixels(NamedTuple):
    """Some pixels of a sensor: runs of neighbours in row-major order."""

    first: int
    count: int
    run: int  # pixels side by side
    apart: int  # pixels from the start of one run to that of the next

    def index(self, device: torch.device) -> Tensor:
        """(count,) int32, their row-major numbers."""
        place = torch.arange(self.count, dtype=torch.int32, device=device)
        return place + torch.div(place, self.run, rounding_mode="floor") * (self.apart - self.run) + self.first


class Chunk(NamedTuple):
    """A block of lanes that is traced together: some samples of some pixels of one sensor."""

    sensor: int  # row of the output batch
    pixels: Pixels
    first_sample: int
    samples: int

    @property
    def lanes(self) -> int:
        return self.pixels.count * self.samples


def plan_chunks(sensors: int, pixels: int, spp: int, lanes: int, workers: int) -> list[Chunk]:
    """Blocks that cover all pixels and samples: whole pixels if they fit, else so many samples of one as `sums_in_pairs`
    sums alike in blocks and at once. Successive blocks of a sensor share their pixels as fairly as possible.

    Args:
        sensors: of the call.
        pixels: of each.
        spp: samples of a pixel.
        lanes: the most of a block.
        workers: that the blocks are dealt out to in turn.
    """
    samples = spp if spp <= lanes else 1 << lanes.bit_length() - 1
    return [Chunk(sensor, some, first_sample, min(samples, spp - first_sample))
            for sensor in range(sensors)
            for some in dealt_out(pixels, max(1, lanes // samples), workers)
            for first_sample in range(0, spp, samples)]


def dealt_out(pixels: int, most: int, workers: int) -> Iterator[Pixels]:
    """All pixels of a sensor, dealt out run by run to chunks, so that each is like the whole image.

    Args:
        pixels: how many there are.
        most: of a chunk.
        workers: that are to get as many chunks each, if there are pixels for so many.
    """
    run = min(RUN, most)
    most -= most % run
    workers = min(workers, -(-pixels // most))
    chunks = workers * -(-pixels // (most * workers))
    rounds, rest = divmod(pixels, run * chunks)
    for number in range(chunks):
        count = rounds * run + min(run, max(0, rest - number * run))
        if count:
            yield Pixels(number * run, count, run, run * chunks)


def fair_chunk(sensors: int, pixels: int, spp: int, workers: int, about: int) -> int:
    """The lanes of chunks of about a wanted size, such that all workers get as many; args as for `plan_chunks`."""
    lanes = pixels * spp
    chunks = max(1, round(lanes / about))  # of a sensor
    while sensors * chunks % workers and lanes >= (chunks + 1) * LEAST_LANES:
        chunks += 1
    chunk = -(-lanes // chunks)
    return chunk if chunk < spp else -(-chunk // (RUN * spp)) * RUN * spp  # whole runs
