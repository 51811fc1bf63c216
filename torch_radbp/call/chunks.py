"""Chunks: blocks of lanes that are traced together, and their distribution to threads ("workers").

Which part of an image is dear is not known before: the sky costs one bounce, a mesh below it six. So chunks do not each take
a part of the image, but all take rows of pixels in turn: workers finish together, and what one chunk needs, all need. Large
images are rendered in bands, one after the other, so that only the sums of a few rows wait for those of their neighbours.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple, Protocol

import torch
from torch import Tensor

from torch_radbp.film.splat import TOGETHER

LEAST_LANES = 1 << 17  # of a chunk if the user does not say: below, a second one costs more in Python than it gains
BAND = 1 << 18  # pixels of a band, about


class LaneBlock(Protocol):
    """The interface of a chunk: a block of lanes that is traced together."""

    @property
    def lanes(self) -> int:
        """The number of lanes of the chunk."""

    @property
    def group(self) -> int:
        """The number of the chunk's group: groups are traced one after the other, the chunks of one in parallel."""


class LaneRange(NamedTuple):
    """A chunk of consecutive lanes that belong to no pixels."""

    first: int
    lanes: int
    group: int = 0


class Rows(NamedTuple):
    """Some equidistant rows of pixels of a sensor."""

    first: int
    count: int
    apart: int  # distance from one row to the next
    columns: int  # pixels in each row

    def numbers(self, device: torch.device, columns: int | None = None) -> Tensor:
        """(count * columns,) int32, the row-major indices of these pixels in an image of `columns` or more columns."""
        row = (torch.arange(self.count, dtype=torch.int32, device=device) * self.apart + self.first)[:, None]
        column = torch.arange(self.columns, dtype=torch.int32, device=device)
        return (row * (columns or self.columns) + column).flatten()


class Chunk(NamedTuple):
    """A block of lanes that is traced together: some samples of some rows of pixels of one sensor."""

    sensor: int  # row of the output batch
    rows: Rows
    first_sample: int
    samples: int
    band: range  # rows of the band that is developed together
    group: int  # index of a group of bands that are rendered side by side

    @property
    def lanes(self) -> int:
        return self.rows.count * self.rows.columns * self.samples


def plan_chunks(grids: Sequence[tuple[int, int]], spp: int, lanes: int, workers: int) -> list[Chunk]:
    """Divides all pixels and samples into chunks: whole rows with all samples if they fit, else one row with some samples.

    Args:
        grids: for each sensor, columns and rows of pixels that have samples.
        spp: samples per pixel.
        lanes: the most of a chunk, except for the samples of a row that the film takes at once.
        workers: the number of threads to which chunks are dealt in turn.
    """
    found, group, pixels = [], 0, 0
    for sensor, (columns, rows) in enumerate(grids):
        samples = spp if columns * spp <= lanes else min(spp, max(TOGETHER, 1 << max(1, lanes // columns).bit_length() - 1))
        most = max(1, lanes // (columns * samples)) if samples == spp else 1
        for band in bands(columns, rows, most * workers):
            size = len(band) * columns
            if pixels and pixels + size > BAND:
                group, pixels = group + 1, 0
            pixels += size
            found += [Chunk(sensor, Rows(band.start + first, count, apart, columns), first_sample,
                            min(samples, spp - first_sample), band, group)
                      for first, count, apart in dealt_out(len(band), most, workers)
                      for first_sample in range(0, spp, samples)]
    return found


def bands(columns: int, rows: int, least: int) -> Iterator[range]:
    """Divides the rows of an image into bands of about `BAND` pixels, but at least `least` rows."""
    count = max(1, min(round(rows * columns / BAND), rows // least))
    borders = [rows * number // count for number in range(count + 1)]
    return (range(*pair) for pair in zip(borders, borders[1:]))


def dealt_out(rows: int, most: int, workers: int) -> Iterator[tuple[int, int, int]]:
    """Deals the rows of a band to chunks in turn, so that chunks are alike: yields first row, number and distance of each.

    Args:
        rows: the number of rows.
        most: the most rows of a chunk.
        workers: the threads, which get equally many chunks if there are enough rows.
    """
    workers = min(workers, -(-rows // most))
    chunks = workers * -(-rows // (most * workers))
    for number in range(min(chunks, rows)):
        yield number, -(-(rows - number) // chunks), chunks


def fair_chunk(grids: Sequence[tuple[int, int]], spp: int, workers: int, about: int) -> int:
    """A chunk size in lanes, close to `about`, that gives all workers equally many chunks; args as for `plan_chunks`."""
    columns, rows = max(grids)
    lanes = columns * rows * spp
    chunks = max(1, round(lanes / about))  # of a sensor
    while len(grids) * chunks % workers and lanes >= (chunks + 1) * LEAST_LANES:
        chunks += 1
    chunk, row = -(-lanes // chunks), columns * spp
    return chunk if chunk < row else -(-chunk // row) * row
