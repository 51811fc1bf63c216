"""The squared error of two renderings, without any bias."""

from __future__ import annotations

from torch import Tensor

from torch_radbp.losses.images import check_images
from torch_radbp.losses.masked import counted, masked_mean


def two_buffer_l2(image_a: Tensor, image_b: Tensor, target: Tensor, mask: Tensor | None = None) -> Tensor:
    """The mean of (image_a - target) (image_b - target) of two independent renderings.

    Value and derivative are unbiased at any number of samples. It may be negative: near the optimum it is a difference of
    noises.

    Args:
        image_a, image_b: (B, 3, H, W), attached; of two seeds.
        target: (B, 3, H, W); NaN and infinity do not count where the mask is 0.
        mask: (B, 1, H, W) or (B, 3, H, W) weights of at least 0; None: all pixels count the same.

    Returns:
        A scalar.

    Raises:
        ValueError: if the shapes or devices differ, the mask is negative, or the target is not finite where it counts.
        TypeError: for another dtype than float32 and float64.
    """
    check_images(image_a=image_a, image_b=image_b, target=target)
    target = counted(target, mask)
    return masked_mean((image_a - target) * (image_b - target), mask)
