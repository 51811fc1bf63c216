"""What samples count in the pixels around them, and what these pixels ask of the samples: two functions of lanes.

For each pixel the samples in it are summed, once for each offset to a pixel in which they count, so that no two lanes write
to one place. `develop.py` moves these sums to where they belong. They are sums of pairs, of pairs of pairs, ... of samples,
so that they are the same whichever samples are traced together.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.differentiated import any_differentiated
from torch_radbp.film.filter import Kernel
from torch_radbp.vec import Vec2, gather

TOGETHER = 8  # samples of a pixel that a lane adds up; compiled, for it takes the more operations the more there are
PIECE = 1 << 14  # pixels whose sums are made at once, less where they have many samples


class Block(NamedTuple):
    """Some samples of some pixels: P pixels with as many lanes each, one after the other."""

    place: Vec2  # (N,) where in its pixel each sample lies, in [0, 1)
    samples: int  # of a pixel
    spp: int  # of a pixel, with those that are traced with other lanes


def deposited(kernel: Kernel, values: tuple[Tensor, ...], place: Vec2, first: Tensor, left: Tensor,
              count: int) -> tuple[Tensor, ...]:
    """The sums over some samples of a pixel of what they count in the pixels around it.

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
    sums = []
    for number in range(count):
        there = left > number
        sample = torch.where(there, first + number, first)
        across, down = (kernel.around(gather(part, sample)) for part in place)
        own = [gather(value, sample) for value in values]
        counts = [torch.where(there, in_row, 0.0) * in_column for in_row in down for in_column in across]
        sums.append([term for each in counts for term in (each, *(value * each for value in own))])
    while len(sums) > 1:
        sums = [[a + b for a, b in zip(*sums[pair:pair + 2])] if len(sums[pair:pair + 2]) == 2 else sums[pair]
                for pair in range(0, len(sums), 2)]
    return tuple(sums[0])


def asked(kernel: Kernel, pixels: tuple[Tensor, ...], place: Vec2, first: Tensor, down: Tensor,
          across: Tensor) -> tuple[Tensor, ...]:
    """What the pixels around ask of samples: the transpose of `deposited`.

    Args:
        kernel: the reconstruction filter.
        pixels: tables, one for each value of a sample: what each pixel asks for.
        place: (N,) of the samples.
        first: (N,) int32, the entry of the upper left pixel in which a sample counts.
        down, across: () int32, entries from one row of these pixels to the next, and from one column.
    """
    totals = [0.0] * len(pixels)
    columns = kernel.around(place.x)
    for row, in_row in enumerate(kernel.around(place.y)):
        for column, in_column in enumerate(columns):
            entry = first + (down * row + across * column)
            totals = [total + gather(table, entry) * (in_row * in_column) for total, table in zip(totals, pixels)]
    return tuple(totals)


def sums_in_pairs(terms: Tensor, dimension: int) -> Tensor:
    """Sums over a dimension: of neighbours, of neighbouring pairs, of pairs of pairs, ..."""
    while terms.shape[dimension] > 1:
        length = terms.shape[dimension]
        even, odd = (terms[(slice(None),) * dimension + (slice(start, None, 2),)] for start in (0, 1))
        pairs = even.narrow(dimension, 0, length // 2) + odd
        terms = pairs if length % 2 == 0 else torch.cat([pairs, even.narrow(dimension, length // 2, 1)], dimension)
    return terms.squeeze(dimension)


def offset_sums(stage: Callable, kernel: Kernel, values: tuple[Tensor, ...], block: Block) -> Tensor:
    """(R, R, 1 + C, P) for each offset, down and across, the sums over the samples of a pixel: of the filter, and of values.

    Attached to the values.

    Args:
        stage: `deposited`, or the same compiled.
        kernel: the reconstruction filter; R is 2 reach + 1.
        values: C of (P samples,).
        block: of the samples.
    """
    if any_differentiated(values):
        filters = offset_sums(stage, kernel, (), block)
        return torch.cat([filters, Deposited.apply(kernel, block, *values)], 2)
    return sums_of(stage, kernel, values, block)


def sums_of(stage: Callable, kernel: Kernel, values: tuple[Tensor, ...], block: Block) -> Tensor:
    """`offset_sums`, detached."""
    (place, samples, spp), size, count = block, 2 * kernel.reach + 1, 1
    if kernel.flat:
        one = torch.ones_like(place.x)
        return sums_in_pairs(torch.stack([one, *values]).view(1, 1, 1 + len(values), -1, samples), 4)
    # The same for all samples of a pixel: a compiled sum of products rounds otherwise if there are more of them.
    while hasattr(stage, "into") and count < min(spp, TOGETHER):
        count *= 2
    parts, pixels, like = -(-samples // count), len(place.x) // samples, place.x
    start = torch.arange(0, samples, count, dtype=torch.int32, device=like.device)[:, None]
    first = (torch.arange(pixels, dtype=torch.int32, device=like.device) * samples + start).flatten()
    left = (samples - start).repeat(1, pixels).flatten()
    arguments = kernel, values, place, first, left, count
    if hasattr(stage, "into"):
        found = torch.empty(size * size * (1 + len(values)), parts * pixels, dtype=like.dtype, device=like.device)
        stage.into(found.unbind(0), 0, *arguments)
    else:
        found = torch.stack(stage(*arguments))
    return sums_in_pairs(found.view(size, size, 1 + len(values), parts, pixels), 3)


def asked_of_sums(kernel: Kernel, block: Block, sums: Tensor) -> tuple[Tensor, ...]:
    """C of (P samples,): what (R, R, C, P) sums over the samples of a pixel, one for each offset, ask of the samples."""
    size, pixels = sums.shape[0], sums.shape[-1]
    pixel = torch.arange(pixels, dtype=torch.int32, device=sums.device).repeat_interleave(block.samples)
    down, across = (torch.full((), entries, dtype=torch.int32, device=sums.device) for entries in (size * pixels, pixels))
    return asked(kernel, tuple(table.flatten() for table in sums.unbind(2)), block.place, pixel, down, across)


class Deposited(torch.autograd.Function):
    """`offset_sums` without those of the filter: linear in the values, and `Asked` is its transpose."""

    @staticmethod
    def forward(ctx, kernel: Kernel, block: Block, *values: Tensor) -> Tensor:
        ctx.kernel, ctx.block = kernel, block
        return sums_of(deposited, kernel, values, block)[:, :, 1:].contiguous()

    @staticmethod
    def backward(ctx, adjoint: Tensor) -> tuple[Tensor | None, ...]:
        return None, None, *Asked.apply(ctx.kernel, ctx.block, adjoint)

    @staticmethod
    def jvp(ctx, _, __, *tangents: Tensor) -> Tensor:
        zero = torch.zeros_like(ctx.block.place.x)
        return sums_of(deposited, ctx.kernel, tuple(zero if own is None else own for own in tangents),
                       ctx.block)[:, :, 1:].contiguous()


class Asked(torch.autograd.Function):
    """`asked_of_sums`: linear in the sums, and `Deposited` is its transpose."""

    @staticmethod
    def forward(ctx, kernel: Kernel, block: Block, sums: Tensor) -> tuple[Tensor, ...]:
        ctx.kernel, ctx.block = kernel, block
        return asked_of_sums(kernel, block, sums)

    @staticmethod
    def backward(ctx, *adjoints: Tensor) -> tuple[Tensor | None, ...]:
        return None, None, Deposited.apply(ctx.kernel, ctx.block, *adjoints)
