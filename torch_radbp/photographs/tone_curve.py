"""The tone curve of a camera: monotone and invertible for all values of its parameters."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn

from torch_radbp.formats.image import linear_to_srgb, srgb_to_linear
from torch_radbp.photographs.linear_images import check_linear_images, check_numbers
from torch_radbp.plugin import integer, nearest

STARTS = {"srgb": (linear_to_srgb, srgb_to_linear), "identity": (lambda values: values, lambda values: values)}


class Bin(NamedTuple):
    """The piece of a rational spline that contains each value; tensors of the shape of the values, attached."""

    left: Tensor  # start of the piece
    low: Tensor  # value at the start
    height: Tensor  # rise over the piece
    slope: Tensor  # mean slope
    first: Tensor  # slope at the start
    last: Tensor  # slope at the end


class ToneCurve(nn.Module):
    """The response curve of a camera, from exposure in [0, 1] to the values of its files, shared by all views.

    It is a known curve followed by a smooth, strictly increasing spline of [0, 1] that is the identity to begin with; 0 and
    1 stay where they are, and beyond them it goes on with the slope at the end. `inverse` inverts it in closed form.

    Read the files with `curve="linear"`, and then either code the renderings, `curve(exposure(image, views))`, or decode the
    photographs, `curve.inverse(photograph)`. The first weighs errors as the eye does, but is not linear in the image:
    E[curve(I)] differs from curve(E[I]) by about half its curvature times the variance of the rendering, which biases what
    is recovered. The second leaves renderings linear, and is unbiased with `rb.losses.two_buffer_l2`. Where photographs are
    clipped at 1, neither says how bright things are: leave these pixels out by the mask.

    If exposures are unknown too, curve(x^(1/u)) with gains^u and radiance^u explains the same photographs for every u
    (Grossberg and Nayar 2003), and only the rendering tells which is right: fix gains that are known, or begin near the
    truth.

    Parameters, without a unit; 0 is the curve that it starts at:
        log_heights: (C, K) logarithms of how much each of K equal pieces rises, up to their sum.
        log_slopes: (C, K + 1) logarithms of the slopes where pieces meet.

    Args:
        start: the known curve, "srgb" or "identity".
        pieces: K of the spline.
        per_channel: whether red, green and blue have a curve each: C = 3 instead of 1.

    Raises:
        ValueError: if the start is not known.

    Reference: Gregory and Delbourgo 1982, "Piecewise Rational Quadratic Interpolation to Monotonic Data"; Durkan et al.
    2019, "Neural Spline Flows".
    """

    def __init__(self, start: str = "srgb", pieces: int = 8, per_channel: bool = False):
        super().__init__()
        if start not in STARTS:
            raise ValueError(f"start {start!r} is not known; {nearest(str(start), STARTS)}")
        self.start, count = start, integer("pieces", pieces, 1)
        self.log_heights = nn.Parameter(torch.zeros(3 if per_channel else 1, count))
        self.log_slopes = nn.Parameter(torch.zeros(3 if per_channel else 1, count + 1))

    def forward(self, images: Tensor, views: int | Tensor | None = None) -> Tensor:
        """Applies the curve to exposures, and returns values as in image files.

        Args:
            images: (B, 3, H, W) linear, 1 where the camera saturates, attached.
            views: without effect: all views have one curve.

        Returns:
            (B, 3, H, W), attached to images and parameters.

        Raises:
            ValueError: for another shape, and for NaN.
        """
        check_linear_images(images)
        check_numbers(images)
        x = STARTS[self.start][0](images)
        piece = self.piece_of(x, inverse=False)
        share = (x.clamp(0, 1) - piece.left) * self.log_heights.shape[1]
        mixed = share * (1 - share)
        rise = piece.slope * share.square() + piece.first * mixed
        inside = piece.low + piece.height * rise / (piece.slope + (piece.first + piece.last - 2 * piece.slope) * mixed)
        return inside + _beyond(x, piece.first, piece.last)

    def inverse(self, values: Tensor, views: int | Tensor | None = None) -> Tensor:
        """Inverts the curve: the exposures for values in image files; arguments and results as of `forward`."""
        check_linear_images(values)
        check_numbers(values)
        piece, count = self.piece_of(values, inverse=True), self.log_heights.shape[1]
        above = values.clamp(0, 1) - piece.low
        bend = above * (piece.first + piece.last - 2 * piece.slope)
        a = piece.height * (piece.slope - piece.first) + bend
        b = piece.height * piece.first - bend
        c = piece.slope * above
        # The form of the root that does not cancel; the radicand is b^2 or more where the curve bends down, and else
        # (2 a share + b)^2.
        share = 2 * c / (b + (b.square() + 4 * a * c).clamp_min(torch.finfo(b.dtype).tiny).sqrt())
        x = piece.left + share / count + _beyond(values, 1 / piece.first, 1 / piece.last)
        return STARTS[self.start][1](x)

    def piece_of(self, x: Tensor, inverse: bool) -> Bin:
        """The pieces of the spline that contain arguments, or values if `inverse`."""
        count = self.log_heights.shape[1]
        heights, slopes = (part.to(x) for part in (self.log_heights.softmax(1), self.log_slopes.exp()))
        knots = torch.nn.functional.pad(heights.cumsum(1)[:, :-1], (1, 0))  # (C, K) where pieces begin
        channel = torch.arange(3, device=x.device).view(1, 3, 1, 1) % len(heights)
        if inverse:
            inner = knots[:, 1:].detach()[channel[..., None]].squeeze(3)  # (1, 3, 1, 1, K - 1)
            number = (x.detach()[..., None] >= inner).sum(-1)
        else:
            number = (x.detach().clamp(0, 1) * count).long().clamp(max=count - 1)
        height = heights[channel, number]
        return Bin(number.to(x) / count, knots[channel, number], height, height * count, slopes[channel, number],
                   slopes[channel, number + 1])


def _beyond(x: Tensor, first: Tensor, last: Tensor) -> Tensor:
    """The linear continuation of a curve on [0, 1] beyond its ends, with the slopes there."""
    # Not by clamping x, whose derivative at exactly 0, where much is black, would count twice.
    return torch.where(x < 0, x * first, torch.where(x > 1, (x - 1) * last, torch.zeros_like(x)))
