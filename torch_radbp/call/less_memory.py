"""What becomes of a call for which a device has not enough memory: it is done once more, in smaller pieces."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

import torch

from torch_radbp.call.chunks import Chunk, LaneBlock, LaneRange
from torch_radbp.call.render_call import RenderCall
from torch_radbp.call.wavefronts import Wavefront
from torch_radbp.film.splat import TOGETHER

Result = TypeVar("Result")


def again_in_pieces(call: RenderCall, work: Callable[[RenderCall], Result]) -> Result:
    """The result of `work(call)`; if device memory runs out, that of the same call in wavefronts of a quarter of the lanes.

    Raises:
        torch.OutOfMemoryError: if memory runs out again, or the wavefronts cannot be smaller.
    """
    try:
        return work(call)
    except torch.OutOfMemoryError:
        smaller = in_halves(in_halves(call.wavefronts))
        if len(smaller) == len(call.wavefronts):
            raise
    # Not before the error is gone, which holds what it has met.
    if call.scene.device.type == "cuda":
        torch.cuda.empty_cache()
    before, after = (max(wavefront.lanes for wavefront in wavefronts) for wavefronts in (call.wavefronts, smaller))
    warnings.warn(f"there is not enough memory on {call.scene.device} for {before:,} paths at a time: they are traced "
                  f"again, by {after:,}. Renderer(chunk={after}) does so from the beginning", UserWarning, stacklevel=2)
    return work(call._replace(wavefronts=smaller))


def in_halves(wavefronts: Sequence[Wavefront]) -> list[Wavefront]:
    """Splits each wavefront into two, in the same order: its chunks, or a single chunk itself."""
    found = []
    for wavefront in wavefronts:
        chunks, half = wavefront.chunks, len(wavefront.chunks) // 2
        parts = [chunks[:half], chunks[half:]] if half else [(part,) for part in halves_of(chunks[0])]
        found += [Wavefront(tuple(part)) for part in parts]
    return found


def halves_of(chunk: LaneBlock) -> Iterator[LaneBlock]:
    """Yields the halves of a chunk: every other row, or half of the samples of one row; small chunks stay whole."""
    if isinstance(chunk, LaneRange) and chunk.lanes > 1:
        half = chunk.lanes // 2
        yield from (chunk._replace(lanes=half), chunk._replace(first=chunk.first + half, lanes=chunk.lanes - half))
    elif isinstance(chunk, Chunk) and chunk.rows.count > 1:
        rows = chunk.rows
        for first in (0, 1):
            yield chunk._replace(rows=rows._replace(first=rows.first + first * rows.apart, apart=2 * rows.apart,
                                                    count=(rows.count + 1 - first) // 2))
    elif isinstance(chunk, Chunk) and chunk.samples >= 2 * TOGETHER:
        half = chunk.samples // 2 // TOGETHER * TOGETHER
        yield from (chunk._replace(samples=half),
                    chunk._replace(first_sample=chunk.first_sample + half, samples=chunk.samples - half))
    else:
        yield chunk
