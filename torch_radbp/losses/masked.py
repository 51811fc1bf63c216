"""Means of images within a mask."""

from __future__ import annotations

from torch import Tensor

from torch_radbp.losses.images import check_floats


def masked_mean(values: Tensor, mask: Tensor | None = None) -> Tensor:
    """The mean of values of pixels, weighted by a mask: sum(mask values) / sum(mask), of all channels and images.

    Linear in `values`, and so unbiased with any noise, as long as the mask does not depend on the same samples.

    Args:
        values: (B, C, H, W), attached.
        mask: (B, 1, H, W) or (B, C, H, W) weights of at least 0; None: all count the same. Zero everywhere: the mean is 0.

    Returns:
        A scalar.

    Raises:
        TypeError: if the mask is no tensor of floats.
        ValueError: if its shape does not fit.
    """
    if mask is None:
        return values.mean()
    check_floats("mask", mask)
    wanted = {tuple(values.shape), (values.shape[0], 1, *values.shape[2:])}
    if tuple(mask.shape) not in wanted:
        raise ValueError(f"mask must have shape {(values.shape[0], 1, *values.shape[2:])}, got {tuple(mask.shape)}")
    weights = mask.expand_as(values)
    total = weights.sum()
    return (weights * values).sum() / total.where(total > 0, 1.0)
