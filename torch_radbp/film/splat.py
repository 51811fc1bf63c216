"""Splatting of samples to the pixels around them, and its transpose: two functions of lanes.

For each pixel the samples in it are summed, once for each offset to a pixel in which they count, so that no two lanes write
to one place. `develop.py` moves these sums to where they belong. They are sums of pairs, of pairs of pairs, ... of samples,
so that they are the same whichever samples are traced together.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.film.filter import Kernel
from torch_radbp.tensors.differentiated import any_differentiated
from torch_radbp.tensors.stage import EAGER, Stage, stage
from torch_radbp.tensors.vec import Vec2, gather

TOGETHER = 8  # samples of a pixel that a lane adds up; compiled, for it takes the more operations the more there are
MOST_VALUES = 4  # that are added up at once: of many, code takes long to compile
# Pixels whose sums are made at once, less where they have many samples: what a cache of the processor holds; and elsewhere,
# where it takes longer to ask for sums than to make them.
PIECE, PIECE_ELSEWHERE = 1 << 14, 1 << 18


class Block(NamedTuple):
    """Samples of P pixels: equally many lanes for each, pixel after pixel."""

    place: Vec2  # (N,) position of each sample in its pixel, in [0, 1)
    samples: int  # of a pixel
    spp: int  # of a pixel, with samples that other calls trace


@stage("values", "place")
def deposited(kernel: Kernel, values: tuple[Tensor, ...], place: Vec2, first: Tensor, left: Tensor,
              count: int) -> tuple[Tensor, ...]:
    """Splats some samples of a pixel: their filter-weighted sums for each pixel around it.

    Args:
        kernel: the reconstruction filter.
        values: (N,) each, of the samples.
        place: (N,) of the samples.
        first: (M,) int32, the first sample of each sum; the others follow it.
        left: (M,) int32, how many there are from this one on.
        count: of samples, at most.

    Returns:
        (M,) each: for each row of the pixels around, from top to bottom, and each column of them, the sum of the filter,
        and those of the values times it.
    """
    across, down, values_of = [], [], []
    for number in range(count):
        there, sample = left > number, torch.where(left > number, first + number, first)
        across.append(kernel.around(gather(place.x, sample)))
        down.append([torch.where(there, in_row, 0.0) for in_row in kernel.around(gather(place.y, sample))])
        values_of.append([gather(value, sample) for value in values])
    sums = []
    for row in range(2 * kernel.reach + 1):
        for column in range(2 * kernel.reach + 1):
            counts = [in_row[row] * in_column[column] for in_row, in_column in zip(down, across)]
            sums.append(paired(counts))
            sums += [paired([value * each for value, each in zip(samples, counts)]) for samples in zip(*values_of)]
    return tuple(sums)


def paired(terms: list[Tensor]) -> Tensor:
    """Sums by pairwise summation."""
    while len(terms) > 1:
        terms = [terms[k] + terms[k + 1] if k + 1 < len(terms) else terms[k] for k in range(0, len(terms), 2)]
    return terms[0]


class PixelAdjoints(NamedTuple):
    """The adjoints (derivatives of the loss) of pixels, from which those of samples are gathered."""

    tables: tuple[Tensor, ...]  # one for each value of a sample, with an entry for each pixel
    down: Tensor  # () int32, entries from one row of pixels to the next
    across: Tensor  # () int32, and from one column


@stage("pixels", "place")
def gathered_from_pixels(kernel: Kernel, pixels: PixelAdjoints, place: Vec2, entry: Tensor, first: Tensor, left: Tensor,
                         count: int) -> tuple[Tensor, ...]:
    """The transpose of `deposited`: gathers the adjoints of some samples of a pixel from the pixels around it.

    Args:
        kernel: the reconstruction filter.
        pixels: the adjoints of pixels.
        place: (N,) of the samples.
        entry: (M,) int32, the index in the tables of the upper left pixel in which the samples count.
        first, left, count: which samples; see `deposited`.

    Returns:
        (M,) each: for each sample the adjoints of its values.
    """
    size, (tables, down, across) = range(2 * kernel.reach + 1), pixels
    around = [[[gather(table, entry + (down * row + across * column)) for table in tables] for column in size]
              for row in size]
    adjoints = []
    for number in range(count):
        sample = torch.where(left > number, first + number, first)
        columns, rows = (kernel.around(gather(part, sample)) for part in place)
        totals = [0.0] * len(tables)
        for in_row, of_row in zip(rows, around):
            in_rows = [in_row * in_column for in_column in columns]
            totals = [total + sum(each * pixel[k] for each, pixel in zip(in_rows, of_row)) for k, total in enumerate(totals)]
        adjoints += totals
    return tuple(adjoints)


def sums_in_pairs(terms: Tensor, dimension: int) -> Tensor:
    """Sums over a dimension by pairwise summation."""
    while terms.shape[dimension] > 1:
        length = terms.shape[dimension]
        even, odd = (terms[(slice(None),) * dimension + (slice(start, None, 2),)] for start in (0, 1))
        pairs = even.narrow(dimension, 0, length // 2) + odd
        terms = pairs if length % 2 == 0 else torch.cat([pairs, even.narrow(dimension, length // 2, 1)], dimension)
    return terms.squeeze(dimension)


def offset_sums(stage: Stage, kernel: Kernel, values: tuple[Tensor, ...], block: Block) -> Tensor:
    """(R, R, 1 + C, P) for each offset, down and across: a pixel's sums of filter weights and of weighted values.

    Attached to the values.

    Args:
        stage: `deposited`, as it is run.
        kernel: the reconstruction filter; R is 2 reach + 1.
        values: C of (P samples,).
        block: of the samples.
    """
    if any_differentiated(values):
        filters = offset_sums(stage, kernel, (), block)
        return torch.cat([filters, Deposited.apply(kernel, block, *values)], 2)
    return sums_of(stage, kernel, values, block)


def sums_of(stage: Stage, kernel: Kernel, values: tuple[Tensor, ...], block: Block) -> Tensor:
    """Computes the sums by offset that `offset_sums` returns, detached."""
    (place, samples, _), size = block, 2 * kernel.reach + 1
    if len(values) > MOST_VALUES:
        some, others = (sums_of(stage, kernel, part, block) for part in (values[:MOST_VALUES], values[MOST_VALUES:]))
        return torch.cat([some, others[:, :, 1:]], 2)
    if kernel.flat:
        filters = place.x.new_full((1, 1, 1, len(place.x) // samples), samples)
        if not values:
            return filters
        return torch.cat([filters, sums_in_pairs(torch.stack(values).view(1, 1, len(values), -1, samples), 4)], 2)
    first, left, count = _parts_of(stage, block)
    lanes = first.t().flatten(), left.t().flatten(), count  # part by part, so that parts lie apart and are quickly added
    sums = results_of(stage, size * size * (1 + len(values)), kernel, values, place, *lanes)
    return sums_in_pairs(sums.view(size, size, 1 + len(values), -1, len(place.x) // samples), 3)


def _parts_of(stage: Stage, block: Block) -> tuple[Tensor, Tensor, int]:
    """Splits each pixel's samples of a block into parts: `first` and `left`, (P, parts of a pixel), and `count`, by which
    `deposited` takes the samples of a part."""
    (place, samples, spp), count = block, 1
    # The same for all samples of a pixel: a compiled sum of products rounds otherwise if there are more of them.
    while stage.is_compiled and count < min(spp, TOGETHER):
        count *= 2
    pixels, device = len(place.x) // samples, place.x.device
    start = torch.arange(0, samples, count, dtype=torch.int32, device=device)
    first = torch.arange(pixels, dtype=torch.int32, device=device)[:, None] * samples + start
    return first, (samples - start).expand(pixels, -1), count


def results_of(stage: Stage, number: int, kernel: Kernel, values: tuple, place: Vec2, *lanes) -> Tensor:
    """Runs a stage and returns its results in one tensor, (number, M)."""
    if not stage.is_compiled:
        return torch.stack(stage(kernel, values, place, *lanes))
    results = torch.empty(number, len(lanes[0]), dtype=place.x.dtype, device=place.x.device)
    stage.into(results.unbind(0), 0, kernel, values, place, *lanes)
    return results


def gathered_by(stage: Stage, kernel: Kernel, tables: tuple[Tensor, ...], block: Block, entry: Tensor, down: int,
                across: int) -> tuple[Tensor, ...]:
    """C of (P samples,): the adjoints of samples, gathered from the adjoints of the pixels around them.

    Args:
        stage: `gathered_from_pixels`, as it is run.
        kernel: the reconstruction filter.
        tables: C, as of `PixelAdjoints`; `down`, `across` likewise.
        block: of the samples.
        entry: (P,) int32, the index in the tables of the upper left pixel in which the samples of each pixel count.
    """
    first, left, count = _parts_of(stage, block)
    parts = first.shape[1]
    steps = (torch.full((), entries, dtype=torch.int32, device=entry.device) for entries in (down, across))
    lanes = entry.repeat_interleave(parts), first.flatten(), left.flatten(), count
    adjoints = results_of(stage, count * len(tables), kernel, PixelAdjoints(tables, *steps), block.place, *lanes)
    adjoints = adjoints.view(count, -1).t().contiguous().view(len(tables), len(entry), parts * count)
    return adjoints[:, :, :block.samples].flatten(1).unbind(0)


def gathered_from_sums(kernel: Kernel, block: Block, sums: Tensor) -> tuple[Tensor, ...]:
    """C of (P samples,): the adjoints of samples, from those of their (R, R, C, P) sums by offset."""
    size, pixels = sums.shape[0], sums.shape[-1]
    pixel = torch.arange(pixels, dtype=torch.int32, device=sums.device)
    tables = tuple(table.flatten() for table in sums.unbind(2))
    return gathered_by(EAGER(gathered_from_pixels), kernel, tables, block, pixel, size * pixels, pixels)


class Deposited(torch.autograd.Function):
    """A pixel's sums of filter-weighted values for each offset, linear in the values; `Gathered` is the transpose."""

    @staticmethod
    def forward(ctx, kernel: Kernel, block: Block, *values: Tensor) -> Tensor:
        ctx.kernel, ctx.block = kernel, block
        return sums_of(EAGER(deposited), kernel, values, block)[:, :, 1:].contiguous()

    @staticmethod
    def backward(ctx, adjoint: Tensor) -> tuple[Tensor | None, ...]:
        return None, None, *Gathered.apply(ctx.kernel, ctx.block, adjoint)

    @staticmethod
    def jvp(ctx, _, __, *tangents: Tensor) -> Tensor:
        zero = torch.zeros_like(ctx.block.place.x)
        return sums_of(EAGER(deposited), ctx.kernel, tuple(zero if tangent is None else tangent for tangent in tangents),
                       ctx.block)[:, :, 1:].contiguous()


class Gathered(torch.autograd.Function):
    """The adjoints of samples' values from those of the sums for each offset, linear in these; transpose of `Deposited`."""

    @staticmethod
    def forward(ctx, kernel: Kernel, block: Block, sums: Tensor) -> tuple[Tensor, ...]:
        ctx.kernel, ctx.block = kernel, block
        return gathered_from_sums(kernel, block, sums)

    @staticmethod
    def backward(ctx, *adjoints: Tensor) -> tuple[Tensor | None, ...]:
        return None, None, Deposited.apply(ctx.kernel, ctx.block, *adjoints)
