"""Error images that show where, and how far, two images differ."""

import torch
from torch import Tensor

from torch_radbp.check.statistics import quantile

# Black, violet, red, orange, pale yellow: rising lightness, so it also reads in grey. Linear RGB.
_ANCHORS = torch.tensor([[0.0, 0.0, 0.0], [0.09, 0.01, 0.2], [0.5, 0.02, 0.12], [0.95, 0.25, 0.02], [1.0, 0.95, 0.6]])

# Dark blue, blue, white, red, dark red: zero is white, the signs differ in hue and also for the colour-blind. Linear RGB.
_SIGNED_ANCHORS = torch.tensor(
    [[0.0, 0.02, 0.13], [0.06, 0.27, 0.6], [1.0, 1.0, 1.0], [0.8, 0.14, 0.07], [0.14, 0.0, 0.01]]
)


def absolute_error(image: Tensor, target: Tensor) -> Tensor:
    """Returns |image - target|, same shape."""
    return (image - target).abs()


def error_scale(error: Tensor) -> float:
    """Returns the error that is shown brightest: the 99.5 % quantile over pixels, so that fireflies do not set it."""
    return max(quantile(error.amax(dim=-3), 0.995).item(), 1e-6)


def false_colour(error: Tensor, scale: float) -> Tensor:
    """Maps the largest channel of a (3, H, W) error to colours (3, H, W), linear RGB; `scale` is brightest."""
    return _interpolated(_ANCHORS, (error.amax(dim=0) / scale).clamp(0, 1))


def signed_colour(values: Tensor, scale: float) -> Tensor:
    """Maps signed (H, W) numbers to colours (3, H, W), linear RGB: zero white, -scale dark blue, +scale dark red."""
    return _interpolated(_SIGNED_ANCHORS, (values / (2 * scale) + 0.5).clamp(0, 1))


def _interpolated(anchors: Tensor, level: Tensor) -> Tensor:
    """Returns (3, H, W) colours between the anchors for (H, W) levels in [0, 1]."""
    anchors, level = anchors.to(level), level * (len(anchors) - 1)
    below = level.floor().long().clamp(max=len(anchors) - 2)
    fraction = (level - below)[..., None]
    colours = anchors[below] * (1 - fraction) + anchors[below + 1] * fraction
    return colours.permute(2, 0, 1)
