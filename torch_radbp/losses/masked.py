"""Means of images within a mask."""

from __future__ import annotations

from torch import Tensor

from torch_radbp.losses.images import check_floats
from torch_radbp.tensors.torch_internals import transforms


def masked_mean(values: Tensor, mask: Tensor | None = None) -> Tensor:
    """The mean of values of pixels, weighted by a mask: sum(mask values) / sum(mask), of all channels and images.

    Linear in `values`, and so unbiased with any noise, as long as the mask does not depend on the same samples. Values where
    the mask is 0 do not count, NaN neither; but what NaN was made of may have a derivative that is NaN.

    Args:
        values: (B, C, H, W), attached.
        mask: (B, 1, H, W) or (B, C, H, W) weights of at least 0; None: all count the same. Zero everywhere: the mean is 0.

    Returns:
        A scalar.

    Raises:
        TypeError: if the mask is no tensor of floats.
        ValueError: if its shape does not fit, or it has values below 0.
    """
    if mask is None:
        return values.mean()
    check_floats("mask", mask)
    wanted = {tuple(values.shape), (values.shape[0], 1, *values.shape[2:])}
    if tuple(mask.shape) not in wanted:
        raise ValueError(f"mask must have shape {(values.shape[0], 1, *values.shape[2:])}, got {tuple(mask.shape)}")
    check_weights(mask)
    weights = mask.expand_as(values)
    total = weights.sum()
    return (weights * values.where(weights != 0, 0.0)).sum() / total.where(total > 0, 1.0)


def counted(target: Tensor, mask: Tensor | None) -> Tensor:
    """`target` with NaN and infinity replaced by 0 where the mask is 0, so that they do not spoil derivatives.

    Raises:
        TypeError: if the mask is no tensor of floats.
        ValueError: if it has values below 0, or the target NaN or infinity where they count.
    """
    finite = target.isfinite()
    if mask is not None:
        check_floats("mask", mask)
        check_weights(mask)
        target, finite = target.where(finite | (mask != 0), 0.0), finite | (mask == 0)
    if not transforms() and not finite.all():
        raise ValueError(f"target has {int((~finite).sum())} values that are NaN or infinite; a mask that is 0 there leaves "
                         f"them out")
    return target


def check_weights(mask: Tensor) -> None:
    """Raises ValueError unless a mask is at least 0 and finite; torch's transforms hide its values."""
    if transforms() or (mask.isfinite() & (mask >= 0)).all():
        return
    low = "NaN or infinity" if not mask.isfinite().all() else f"{float(mask.min()):g}"
    raise ValueError(f"mask must be at least 0, how much of a pixel counts, got {low}")
