"""The squared error of logarithms."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_radbp.losses.images import check_images
from torch_radbp.losses.masked import counted, masked_mean
from torch_radbp.plugin import positive


def two_buffer_log_l2(image_a: Tensor, image_b: Tensor, target: Tensor, mask: Tensor | None = None,
                      epsilon: float = 1e-2) -> Tensor:
    """The mean of (log a - log T) (log b - log T), with epsilon added to each: an error of ratios, for a wide range.

    The product of two renderings takes their noise apart, and yet it is biased: E[log I] is less than log E[I], by about
    var(I) / (2 (I + epsilon)^2). So an image is made too bright by about that share: with twice as many samples by half of
    it, and with a larger epsilon less. Values below 0, of filters with negative lobes, count as 0.

    Args:
        image_a, image_b: (B, 3, H, W) linear, attached; of two seeds.
        target: (B, 3, H, W); NaN and infinity do not count where the mask is 0.
        mask: (B, 1, H, W) or (B, 3, H, W) weights of at least 0; None: all pixels count the same.
        epsilon: what counts as black.

    Returns:
        A scalar.

    Raises:
        ValueError: if the shapes or devices differ, the mask is negative, the target is not finite where it counts, or
            epsilon is not positive.
        TypeError: for another dtype than float32 and float64.
    """
    check_images(image_a=image_a, image_b=image_b, target=target)
    target = counted(target, mask)
    least = positive("epsilon", epsilon)
    a, b, wanted = (torch.log(image.clamp_min(0) + least) for image in (image_a, image_b, target))
    return masked_mean((a - wanted) * (b - wanted), mask)
