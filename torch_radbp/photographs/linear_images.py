"""Checks of the arguments of camera models."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_radbp.tensors.torch_internals import transforms


def check_linear_images(images: Tensor) -> None:
    """Raises ValueError unless `images` are (B, 3, H, W), TypeError unless they are floats."""
    if not isinstance(images, Tensor) or not images.is_floating_point():
        got = images.dtype if isinstance(images, Tensor) else type(images).__name__
        raise TypeError(f"images must be a tensor of floating point numbers, got {got}")
    if images.ndim != 4 or images.shape[1] != 3:
        raise ValueError(f"images must have shape (B, 3, H, W), got {tuple(images.shape)}")


def check_numbers(images: Tensor) -> None:
    """Raises ValueError if `images` contain NaN; skipped under torch's transforms, which hide values."""
    if not transforms() and images.isnan().any():
        raise ValueError(f"images have {int(images.isnan().sum())} values that are NaN, which no tone curve codes; put "
                         f"numbers where the mask is 0")


def view_indices(views: int | Tensor, images: Tensor, count: int) -> Tensor:
    """The view of each image, (B,) int64 on the images' device.

    Raises:
        ValueError: if there is not one for each image, or there is no such view.
    """
    indices = torch.as_tensor(views, device=images.device).reshape(-1)
    if indices.is_floating_point() or indices.dtype == torch.bool or len(indices) != len(images):
        raise ValueError(f"views must be one integer for each of {len(images)} images, got {views!r:.80}")
    if len(indices) and not 0 <= int(indices.min()) <= int(indices.max()) < count:
        raise ValueError(f"views must be from 0 to {count - 1}, got {indices.tolist()}")
    return indices.long()
