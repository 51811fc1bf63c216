"""How far two noisy derivative images are apart, in units of their standard error and in units of the derivative.

A pixel alone is noisy; the whole image may hide errors that cancel. So both are looked at, and between them a grid of
tiles, whose sums are close to normal (a pixel with one rare bright path in it is not) and few enough to keep an error in
place.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d

TILES = 8  # along each side of an image
FLOOR = 0.2  # of the derivative's size, below which a pixel's error is not divided by the pixel
STEP_ERROR = 0.01  # relative, that finite differences may have by their step
CALM = (31, 32)  # the share of tiles without the few that rare bright paths make noisy
SHARED = 0.25  # of the mean variance of those, which every tile has at least
BRIGHTEST = 0.995  # quantile that stands for the maximum of an image, so that fireflies do not


class Samples(NamedTuple):
    """R independent estimates of each kind, float64."""

    difference: Tensor  # (R, B, 3, H, W) by finite differences
    jvp: Tensor  # (R, B, 3, H, W) by forward mode
    rounding: Tensor  # (B, 3, H, W) standard error of `difference` by rounding


class Cotangent(NamedTuple):
    """An image that derivative images are projected on."""

    name: str
    image: Tensor  # (B, 3, H, W) float64


class Projection(NamedTuple):
    """<w, derivative image> for one cotangent w."""

    name: str
    difference: float
    jvp: float
    standard_error: float  # of jvp - difference
    scale: float  # sum over tiles of |<w, difference>|: what nothing cancels in
    backward_error: float  # |<w, JVP> - <VJP(w), d>| of one batch, relative to <|w|, |JVP|>

    @property
    def z(self) -> float:
        """jvp - difference in standard errors."""
        return quotient(self.jvp - self.difference, self.standard_error)

    @property
    def relative_error(self) -> float:
        """jvp - difference relative to `scale`."""
        return quotient(self.jvp - self.difference, self.scale)


class Pixels(NamedTuple):
    """Over all pixels and channels."""

    mean_square_z: float  # about 1 if nothing is wrong; see `expected_square`
    share_above_3: float  # of |z|; 0.003 of a normal distribution, 0.01 of 16 batches
    max_z: float
    # mean of |jvp - difference| / max(|difference|, 0.2 S) with S the 99.5% quantile of |difference|; holds the noise too
    mean_relative_error: float
    concentration: float  # the share of pixels that holds half of the squared error


class Tiles(NamedTuple):
    """Over tiles, 8 x 8 an image, colours added."""

    mean_square_z: float
    limit: float  # of the mean square: five standard deviations above what chance gives
    # root mean square error without what noise explains, relative to the derivative's; tiles count as they are known
    relative_bias: float


class Comparison(NamedTuple):
    """All that was measured. Images are (B, 3, H, W) float64."""

    difference: Tensor
    jvp: Tensor
    standard_error: Tensor  # of jvp - difference
    z: Tensor
    pixels: Pixels
    tiles: Tiles
    projections: list[Projection]
    not_finite: int  # values of `jvp` that are NaN or infinite; 0 was taken for them
    eps: float  # of the renderer's dtype


class Mean(NamedTuple):
    """jvp - difference, and its standard error."""

    error: Tensor
    standard_error: Tensor

    @property
    def z(self) -> Tensor:
        return torch.where(self.standard_error > 0, self.error / self.standard_error,
                           torch.where(self.error == 0, 0.0, math.inf * self.error.sign()))


def mean_error(difference: Tensor, jvp: Tensor, rounding: Tensor) -> Mean:
    """The mean over R of (R, ...) samples and its standard error: of their own spread, and of rounding."""
    variance = (difference.var(0) + jvp.var(0)) / len(jvp) + rounding**2
    return Mean(jvp.mean(0) - difference.mean(0), variance.sqrt())


def expected_square(samples: int) -> float:
    """The mean of z^2 if nothing is wrong: of Student's t with as many degrees of freedom as one of the estimates has."""
    return (samples - 1) / (samples - 3)


def compare(samples: Samples, cotangents: list[Cotangent], backward: list[float], eps: float) -> Comparison:
    """Compares the two estimates.

    Args:
        samples: of both, on any device.
        cotangents: independent of the samples.
        backward: <VJP(w), d> for each cotangent w, of the samples of the first of `samples.jvp`.
        eps: of the renderer's dtype.
    """
    broken = int((~torch.isfinite(samples.jvp)).sum())
    samples = samples._replace(jvp=samples.jvp.nan_to_num(0.0, 0.0, 0.0))
    mean = mean_error(*samples)
    difference, jvp = samples.difference.mean(0), samples.jvp.mean(0)
    projections = [project(samples, cotangent, value) for cotangent, value in zip(cotangents, backward)]
    return Comparison(difference, jvp, mean.standard_error, mean.z, over_pixels(mean, difference), over_tiles(samples),
                      projections, broken, eps)


def over_pixels(mean: Mean, difference: Tensor) -> Pixels:
    z = mean.z
    size = quantile(difference.abs(), BRIGHTEST)
    relative = mean.error.abs() / torch.maximum(difference.abs(), FLOOR * size.clamp_min(1e-300))
    squared = mean.error.square().sum(1).flatten().sort(descending=True).values
    half = int((squared.cumsum(0) < 0.5 * squared.sum()).sum()) + 1
    return Pixels(float(z.square().mean()), float((z.abs() > 3).double().mean()), float(z.abs().max()),
                  float(relative.mean()), half / len(squared) if squared.any() else 0.0)


def over_tiles(samples: Samples) -> Tiles:
    rounding = tile_sums(samples.rounding.square()).sqrt()
    difference, jvp = tile_sums(samples.difference), tile_sums(samples.jvp)
    mean = mean_error(difference, jvp, rounding)
    batch, _, height, width = samples.rounding.shape
    own = mean.standard_error.square()
    noise = steadied(own.view(batch, min(TILES, height), min(TILES, width))).flatten()
    z = mean._replace(standard_error=noise.sqrt()).z
    freedom = len(jvp) - 1
    # The variance of t^2, from the fourth moment of Student's t.
    spread = 3 * freedom**2 / ((freedom - 2) * (freedom - 4)) - expected_square(len(jvp)) ** 2
    limit = expected_square(len(jvp)) + 5 * math.sqrt(spread / z.numel())
    # A tile with rare bright paths must not drown the others; none is known better than finite differences are right.
    size = difference.mean(0).square()
    weight = 1 / (noise + STEP_ERROR**2 * size + 1e-12 * size.mean()).clamp_min(1e-300)
    bias = float((weight * (mean.error.square() - own)).sum().clamp_min(0))
    return Tiles(float(z.square().mean()), limit, math.sqrt(quotient(bias, float((weight * size).sum()))))


def steadied(variance: Tensor) -> Tensor:
    """The variance of tiles, (B, rows, columns), from those around them and from all as well.

    Where a step changes the choice of one sample in thousands, a tile in which none changed lacks their part, and its own
    spread does not tell; that of its neighbours does.
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


def project(samples: Samples, cotangent: Cotangent, backward: float) -> Projection:
    """The two estimates projected on a cotangent, and the forward against the backward pass."""
    w = cotangent.image
    difference, jvp = ((w * images).flatten(1).sum(1) for images in samples[:2])
    mean = mean_error(difference, jvp, (w * samples.rounding).square().sum().sqrt())
    first = samples.jvp[0]
    backward_error = quotient(abs(float(jvp[0]) - backward), float((w * first).abs().sum()))
    return Projection(cotangent.name, float(difference.mean()), float(jvp.mean()), float(mean.standard_error),
                      float(tile_sums(w * samples.difference.mean(0)).abs().sum()), backward_error)


def quantile(values: Tensor, share: float) -> Tensor:
    """The value that `share` of all entries do not exceed."""
    flat = values.flatten()
    return flat.kthvalue(max(1, round(share * len(flat)))).values


def quotient(value: float, unit: float) -> float:
    """value / unit; 0 / 0 is 0, and anything else over 0 infinite."""
    if unit == 0:
        return 0.0 if value == 0 else math.copysign(math.inf, value)
    return value / unit
