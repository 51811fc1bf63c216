"""What the lanes of a call count in its pixels, and what its pixels ask of the lanes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import groupby

import torch
from torch import Tensor

from torch_radbp.rendering.call.chunks import Chunk
from torch_radbp.rendering.call.render_call import (
    RenderCall,
)
from torch_radbp.vec import Vec3


def pixel_sums(chunk: Chunk, values: Iterable[Tensor]) -> Tensor:
    """(C, pixels) the sums over the lanes of each pixel of a chunk, of each of C values."""
    return sums_in_pairs(torch.stack([value.reshape(chunk.pixels.count, chunk.samples) for value in values]))


def sums_in_pairs(terms: Tensor) -> Tensor:
    """Sums over the last dimension: of neighbours, of neighbouring pairs, of pairs of pairs, ...

    So that images do not depend on chunks: the same blocks are summed in the same order in all of them.
    """
    while terms.shape[-1] > 1:
        even, odd = terms[..., ::2], terms[..., 1::2]
        both = odd.shape[-1]
        terms = even + odd if both == even.shape[-1] else torch.cat([even[..., :both] + odd, even[..., both:]], -1)
    return terms.squeeze(-1)


def assembled(call: RenderCall, sums: Sequence[Tensor]) -> Tensor:
    """(B, C, H, W) the images whose chunks have these sums, (C, pixels) each."""
    view, channels = call.views[0], len(sums[0])
    images = [torch.zeros(channels, view.height * view.width, dtype=call.scene.dtype, device=call.scene.device)
              for _ in call.views]
    for (sensor, pixels), parts in groupby(zip(call.chunks, sums), lambda part: part[0][:2]):
        total = sums_in_pairs(torch.stack([own for _, own in parts], -1))
        images[sensor].index_copy_(1, pixels.index(total.device).long(), total / call.spp)
    # Stacked in their final shape: what is no view may be changed in place, also where gradients are wanted.
    return torch.stack([image.reshape(channels, view.height, view.width) for image in images])


def lane_adjoint(call: RenderCall, chunk: Chunk, grad_images: Tensor) -> Vec3:
    """Derivative of the loss with respect to what counts of L_1 of each lane: a pixel is the mean of its samples."""
    gradient = grad_images[chunk.sensor].reshape(3, -1).index_select(1, chunk.pixels.index(grad_images.device)) / call.spp
    return Vec3(*(channel.repeat_interleave(chunk.samples) for channel in gradient))


def weighted(L: Vec3, weight: Tensor | None) -> Vec3:
    """What counts of the lanes' radiance, or of its adjoint."""
    return L if weight is None else L * weight
