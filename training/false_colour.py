"""Error images that show where, and how far, two images differ."""

import torch
from torch import Tensor

# Black, violet, red, orange, pale yellow: rising lightness, so it also reads in grey. Linear RGB.
_ANCHORS = torch.tensor([[0.0, 0.0, 0.0], [0.09, 0.01, 0.2], [0.5, 0.02, 0.12], [0.95, 0.25, 0.02], [1.0, 0.95, 0.6]])


def absolute_error(image: Tensor, target: Tensor) -> Tensor:
    """Returns |image - target|, same shape."""
    return (image - target).abs()


def error_scale(error: Tensor) -> float:
    """Returns the error that is shown brightest: the 99.5 % quantile over pixels, so that fireflies do not set it."""
    largest = error.amax(dim=-3).flatten()
    rank = max(1, round(0.995 * largest.numel()))
    return max(largest.kthvalue(rank).values.item(), 1e-6)


def false_colour(error: Tensor, scale: float) -> Tensor:
    """Maps the largest channel of a (3, H, W) error to colours (3, H, W), linear RGB; `scale` is brightest."""
    level = (error.amax(dim=0) / scale).clamp(0, 1) * (len(_ANCHORS) - 1)
    below = level.floor().long().clamp(max=len(_ANCHORS) - 2)
    fraction = (level - below)[..., None]
    colours = _ANCHORS[below] * (1 - fraction) + _ANCHORS[below + 1] * fraction
    return colours.permute(2, 0, 1)
