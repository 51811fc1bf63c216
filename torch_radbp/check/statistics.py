"""The difference of two noisy derivative images, in standard errors and relative to the derivative.

A single pixel is noisy, and in a sum over the image errors may cancel. So both are examined, and between them a grid of
tiles. Sums over tiles are close to normally distributed, as a pixel with one rare bright path is not, and still tell where
an error is.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d, max_pool2d

from torch_radbp.sampling.running_sum import running_sum

TILES = 8  # along each side of an image
FLOOR = 0.2  # a pixel's error is divided by the pixel, but by no less than this share of the derivative's size
STEP_ERROR = 0.01  # relative error of finite differences that is put down to their step
CALM = (31, 32)  # the share of tiles that remains without those that rare bright paths make noisy
SHARED = 0.25  # least variance of a tile, as a share of the mean variance of the calm ones
KINK, KINK_OF_TILE = 4.0, 2.0  # standard errors from which on a bend is none of the noise; of pixels there are many
BRIGHTEST = 0.995  # the quantile taken for the maximum of an image, because of fireflies


class Estimates(NamedTuple):
    """R independent estimates of a derivative image by each method, float64."""

    difference: Tensor  # (R, B, 3, H, W) by finite differences
    jvp: Tensor  # (R, B, 3, H, W) by forward mode
    rounding: Tensor  # (B, 3, H, W) standard error of `difference` by rounding
    bend: Tensor | None = None  # (R, B, 3, H, W) mean error of one-sided differences; None: not estimated

    def changed(self, halved: Tensor) -> Estimates:
        """The changes of finite differences when the step is halved, for the same samples, to be compared with zero."""
        return Estimates(torch.zeros_like(halved), halved - self.difference, 3 * self.rounding)


class Cotangent(NamedTuple):
    """An image onto which derivative images are projected."""

    name: str
    image: Tensor  # (B, 3, H, W) float64


class Projection(NamedTuple):
    """<w, derivative image> for one cotangent w."""

    name: str
    difference: float
    jvp: float
    standard_error: float  # of jvp - difference
    scale: float  # sum over tiles of |<w, difference>|, without cancellation between tiles
    backward_error: float  # |<w, JVP> - <VJP(w), d>| of one batch, relative to <|w|, |JVP|>
    bend: float = 0.0  # of jvp - difference, the part that is attributed to the step

    @property
    def error(self) -> float:
        """The error jvp - difference beyond what is attributed to the step."""
        error = self.jvp - self.difference
        return math.copysign(max(abs(error) - self.bend, 0.0), error)

    @property
    def z(self) -> float:
        """The error jvp - difference in units of its standard error."""
        return _quotient(self.error, self.standard_error)

    @property
    def relative_error(self) -> float:
        """The error jvp - difference relative to `scale`."""
        return _quotient(self.error, self.scale)

    @property
    def size(self) -> float:
        """The magnitude of the mean of both estimates."""
        return abs(self.difference + self.jvp) / 2


class Pixels(NamedTuple):
    """Statistics over all pixels and channels."""

    mean_square_z: float  # about 1 if nothing is wrong; see `expected_square`
    share_above_3: float  # of |z|; 0.003 for a normal distribution, 0.01 with 16 batches
    max_z: float
    # mean of |jvp - difference| / max(|difference|, 0.2 S) with S the 99.5% quantile of |difference|; includes the noise
    mean_relative_error: float
    concentration: float  # the share of pixels that holds half of the squared error


class Tiles(NamedTuple):
    """Statistics over tiles, 8 x 8 in an image, summed over channels."""

    mean_square_z: float
    limit: float  # of the mean square: five standard deviations above its expectation
    # root mean square error beyond what noise explains, relative to the derivative's; weighted by the tiles' certainty
    relative_bias: float


class Comparison(NamedTuple):
    """All statistics of two derivative images. Images are (B, 3, H, W) float64."""

    difference: Tensor
    jvp: Tensor
    standard_error: Tensor  # of jvp - difference
    z: Tensor
    pixels: Pixels
    tiles: Tiles
    projections: list[Projection]
    not_finite: int  # number of values of `jvp` that are NaN or infinite, which count as 0
    eps: float  # of the renderer's dtype


class Mean(NamedTuple):
    """The mean error of derivatives, forward mode (jvp) less finite difference, and its standard error."""

    error: Tensor
    standard_error: Tensor

    @property
    def z(self) -> Tensor:
        return torch.where(self.standard_error > 0, self.error / self.standard_error,
                           torch.where(self.error == 0, 0.0, math.inf * self.error.sign()))


def mean_error(difference: Tensor, jvp: Tensor, rounding: Tensor) -> Mean:
    """The mean error over R of (R, ...) samples, and its standard error: from their spread, and from rounding."""
    variance = (difference.var(0) + jvp.var(0)) / len(jvp) + rounding**2
    return Mean(jvp.mean(0) - difference.mean(0), variance.sqrt())


def bends(samples: Tensor | None, rounding: Tensor, least: float = KINK) -> Tensor:
    """The mean error that the curvature of images gives finite differences, by R samples, 0 where noise may be all of it."""
    if samples is None:
        return torch.zeros_like(rounding)
    mean, noise = samples.mean(0).abs(), (samples.var(0) / len(samples) + rounding**2).sqrt()
    return torch.where(mean > least * noise, mean, 0.0)


def _beyond(error: Tensor, bend: Tensor) -> Tensor:
    """The part of errors that is not attributed to the step."""
    return error.sign() * (error.abs() - bend).clamp_min(0.0)


def expected_square(samples: int) -> float:
    """The expectation of z^2 for unbiased estimates: that of Student's t with one estimate's degrees of freedom."""
    return (samples - 1) / (samples - 3)


def compare(samples: Estimates, cotangents: list[Cotangent], backward: list[float], eps: float) -> Comparison:
    """Compares the estimates of finite differences and of forward mode.

    Args:
        samples: of both estimates, on any device.
        cotangents: independent of the samples.
        backward: <VJP(w), d> for each cotangent w, from the samples of the first batch of `samples.jvp`.
        eps: of the renderer's dtype.
    """
    broken = int((~torch.isfinite(samples.jvp)).sum())
    samples = samples._replace(jvp=samples.jvp.nan_to_num(0.0, 0.0, 0.0))
    mean = mean_error(*samples[:3])
    mean = mean._replace(error=_beyond(mean.error, bends(samples.bend, samples.rounding)))
    difference, jvp = samples.difference.mean(0), samples.jvp.mean(0)
    projections = [project(samples, cotangent, value) for cotangent, value in zip(cotangents, backward)]
    return Comparison(difference, jvp, mean.standard_error, mean.z, over_pixels(mean, difference), over_tiles(samples),
                      projections, broken, eps)


def over_pixels(mean: Mean, difference: Tensor) -> Pixels:
    z = mean.z
    size = quantile(difference.abs(), BRIGHTEST)
    relative = mean.error.abs() / torch.maximum(difference.abs(), FLOOR * size.clamp_min(1e-300))
    squared = mean.error.square().sum(1).flatten().sort(descending=True).values
    half = int((running_sum(squared) < 0.5 * squared.sum()).sum()) + 1
    return Pixels(float(z.square().mean()), float((z.abs() > 3).double().mean()), float(z.abs().max()),
                  float(relative.mean()), half / len(squared) if squared.any() else 0.0)


def over_tiles(samples: Estimates) -> Tiles:
    rounding = tile_sums(samples.rounding.square()).sqrt()
    difference, jvp = tile_sums(samples.difference), tile_sums(samples.jvp)
    mean = mean_error(difference, jvp, rounding)
    bend = bends(None if samples.bend is None else tile_sums(samples.bend), rounding, KINK_OF_TILE)
    mean = mean._replace(error=_beyond(mean.error, bend))
    batch, _, height, width = samples.rounding.shape
    own = mean.standard_error.square()
    noise = steadied(own.view(batch, min(TILES, height), min(TILES, width))).flatten()
    z = mean._replace(standard_error=noise.sqrt()).z
    freedom = len(jvp) - 1
    # The variance of t^2, from the fourth moment of Student's t.
    spread = 3 * freedom**2 / ((freedom - 2) * (freedom - 4)) - expected_square(len(jvp)) ** 2
    limit = expected_square(len(jvp)) + 5 * math.sqrt(spread / z.numel())
    # A tile with rare bright paths must not drown the others, and no tile is more certain than finite differences are.
    size = difference.mean(0).square()
    weight = 1 / (noise + STEP_ERROR**2 * size + 1e-12 * size.mean()).clamp_min(1e-300)
    bias = float((weight * (mean.error.square() - own)).sum().clamp_min(0))
    return Tiles(float(z.square().mean()), limit, math.sqrt(_quotient(bias, float((weight * size).sum()))))


def steadied(variance: Tensor) -> Tensor:
    """The variance of tiles, (B, rows, columns), smoothed by that of their neighbours and of all tiles.

    If the step changes the path of one sample in thousands, a tile without such a sample lacks that contribution, and its
    own spread does not show it; the spread of its neighbours does.
    """
    around = avg_pool2d(variance[:, None], 3, stride=1, padding=1, count_include_pad=False)[:, 0]
    calm = variance.flatten().sort().values[:-(-variance.numel() * CALM[0] // CALM[1])]
    return torch.maximum((variance + around) / 2, SHARED * calm.mean())


def tile_sums(images: Tensor) -> Tensor:
    """(..., T) sums over channels and tiles of (..., B, 3, H, W) images."""
    batch, _, height, width = images.shape[-4:]
    rows, columns = min(TILES, height), min(TILES, width)
    row = torch.arange(height, device=images.device) * rows // height
    column = torch.arange(width, device=images.device) * columns // width
    tile = (row[:, None] * columns + column).flatten()
    flat = images.sum(-3).flatten(-2)
    sums = flat.new_zeros(*flat.shape[:-1], rows * columns).index_add_(-1, tile, flat)
    return sums.flatten(-2)


def project(samples: Estimates, cotangent: Cotangent, backward: float) -> Projection:
    """Projects both estimates onto a cotangent, and computes the error of the backward pass against forward mode."""
    w = cotangent.image
    difference, jvp = ((w * images).flatten(1).sum(1) for images in samples[:2])
    rounding = (w * samples.rounding).square().sum().sqrt()
    mean = mean_error(difference, jvp, rounding)
    # What edges at the borders of pixels take from one pixel its neighbour gets, of the derivative as of the differences.
    bend = (bends(samples.bend, samples.rounding) * spread_around(w)).sum() / 2
    first = samples.jvp[0]
    backward_error = _quotient(abs(float(jvp[0]) - backward), float((w * first).abs().sum()))
    return Projection(cotangent.name, float(difference.mean()), float(jvp.mean()), float(mean.standard_error),
                      float(tile_sums(w * samples.difference.mean(0)).abs().sum()), backward_error, float(bend))


def spread_around(images: Tensor) -> Tensor:
    """The range of each pixel of (B, C, H, W) images and its eight neighbours."""
    return max_pool2d(images, 3, stride=1, padding=1) + max_pool2d(-images, 3, stride=1, padding=1)


def quantile(values: Tensor, share: float) -> Tensor:
    """The value that a `share` of all entries does not exceed."""
    # Sorted, because torch refuses kthvalue under use_deterministic_algorithms on CUDA.
    ascending = values.flatten().sort().values
    return ascending[max(1, round(share * len(ascending))) - 1]


def _quotient(value: float, unit: float) -> float:
    """The quotient value / unit; 0 / 0 is 0, and anything else over 0 is infinite."""
    if unit == 0:
        return 0.0 if value == 0 else math.copysign(math.inf, value)
    return value / unit
