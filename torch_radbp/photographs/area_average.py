"""Downsampling of images by averages over areas."""

from __future__ import annotations

import torch
from torch import Tensor


def area_average(image: Tensor, width: int, height: int) -> Tensor:
    """Downsamples an image by averaging over the area of each new pixel, parts of old pixels included.

    Args:
        image: (..., H, W).
        width, height: of the result.

    Returns:
        (..., height, width), of the dtype of `image`; attached. The mean of the whole is kept.
    """
    return averaged_rows(averaged_rows(image, width).transpose(-1, -2), height).transpose(-1, -2)


def averaged_rows(values: Tensor, count: int) -> Tensor:
    """(..., count) means over `count` equal parts of the last axis.

    Differences of the integral of a function that is constant on each pixel: exact also where a border of parts is within
    one, and as quick for large reductions as for small ones.
    """
    length = values.shape[-1]
    if length == count:
        return values
    integral = torch.nn.functional.pad(values.double().cumsum(-1), (1, 0))
    border = torch.arange(count + 1, dtype=torch.float64, device=values.device) * (length / count)
    pixel = border.floor().clamp(max=length - 1).long()
    share = border - pixel
    at_border = integral[..., pixel] * (1 - share) + integral[..., pixel + 1] * share
    return (at_border.diff(dim=-1) * (count / length)).to(values.dtype)
