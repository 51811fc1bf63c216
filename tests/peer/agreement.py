"""Do two renderers draw from distributions of the same mean? z-tests per pixel, per block and of the whole image.

Each side gives independent renders ("batches") of one scene. At three scales (pixels, blocks, the whole image) their
mean and its standard error are estimated, and Welch's t gives a p-value per entry. Pixels find what is local and
large (a wrong texel, a shifted edge), the whole image finds what is everywhere and small (2% too dark).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import stats
from scipy.ndimage import maximum_filter, minimum_filter

BLOCK = 8
SCALES = ("pixels", "blocks", "whole")
# One pixel sums thousands of float32 terms and both sides round differently: differences below this are not evidence.
ROUNDING = 2e-5
# A right renderer fails one comparison of these in 10^4; seeds are fixed, so a test passes always or never.
ALPHA = 1e-4


class Estimate(NamedTuple):
    """Mean of independent batches, (h, w, 3) each."""

    mean: np.ndarray
    error: np.ndarray  # standard error of the mean
    batches: int
    samples: int  # per entry, over all batches


@dataclass(frozen=True)
class Comparison:
    """What the test of two sets of renders found."""

    worst_p: dict[str, float]
    """By scale, the smallest p-value times the number of tests (Bonferroni)."""
    worst_at: dict[str, tuple]
    uniform_p: float
    """Kolmogorov-Smirnov: are the p-values of the pixels uniform? Finds errors everywhere that no pixel shows."""
    bias: np.ndarray
    """Relative difference of the image mean by channel."""
    bias_error: np.ndarray
    """Its standard error."""

    @property
    def p(self) -> float:
        """Overall p-value (Bonferroni over the four tests)."""
        return min(1.0, 4 * min(*self.worst_p.values(), self.uniform_p))

    def __str__(self) -> str:
        scales = ", ".join(f"{scale} p={self.worst_p[scale]:.2g} at {self.worst_at[scale]}" for scale in SCALES)
        bias = " ".join(f"{100 * b:+.3f}+-{100 * e:.3f}%" for b, e in zip(self.bias, self.bias_error))
        return f"overall p={self.p:.2g} ({scales}; uniformity p={self.uniform_p:.2g}; bias of the mean {bias})"


def pool(image: np.ndarray, size: int) -> np.ndarray:
    """Means of blocks of ``size`` pixels a side, (ceil(H / size), ceil(W / size), 3); blocks at the edge are smaller."""
    rows, columns = (np.arange(0, n, size) for n in image.shape[:2])
    total = np.add.reduceat(np.add.reduceat(image, rows, axis=0), columns, axis=1)
    count = np.outer(*(np.diff(np.append(start, n)) for start, n in zip((rows, columns), image.shape[:2])))
    return total / count[:, :, None]


def estimate(renders: Iterable[np.ndarray], spp: int) -> dict[str, Estimate]:
    """Mean and error of independent (H, W, 3) renders of ``spp`` samples per pixel, at every scale."""
    images = np.stack([np.asarray(image, dtype=np.float64) for image in renders])
    if not np.isfinite(images).all():
        raise ValueError(f"{(~np.isfinite(images)).sum()} of {images.size} values are NaN or infinite")
    pooled = {"pixels": images, "blocks": np.stack([pool(image, BLOCK) for image in images]),
              "whole": images.mean(axis=(1, 2), keepdims=True)}
    n = len(images)
    pixels = images[0, :, :, 0].size
    return {scale: Estimate(x.mean(0), x.std(0, ddof=1) / np.sqrt(n), n, n * spp * pixels // x[0, :, :, 0].size)
            for scale, x in pooled.items()}


def unseen(ours: Estimate, theirs: Estimate, reach: int) -> np.ndarray:
    """Uncertainty that the spread of the batches does not show.

    Rounding, and in pixels the edges that hardly any sample reaches: an event not seen in n samples may still have
    probability 3 / n (the rule of three), and changes the pixel by no more than ``reach`` pixels around it vary.
    """
    rounding = ROUNDING * np.maximum(abs(ours.mean), abs(theirs.mean)) + 1e-12
    if not reach:
        return rounding
    variation = maximum_filter(theirs.mean, (reach, reach, 1)) - minimum_filter(theirs.mean, (reach, reach, 1))
    return np.hypot(rounding, variation * 3 / min(ours.samples, theirs.samples))


def p_values(ours: Estimate, theirs: Estimate, reach: int) -> np.ndarray:
    """Two-sided p-value of Welch's t for every entry."""
    ours_2, theirs_2 = ours.error**2, theirs.error**2
    variance = ours_2 + theirs_2
    freedom = np.where(
        variance > 0,
        variance**2 / np.maximum(ours_2**2 / (ours.batches - 1) + theirs_2**2 / (theirs.batches - 1), 1e-300),
        ours.batches + theirs.batches - 2,
    )
    t = abs(ours.mean - theirs.mean) / np.sqrt(variance + unseen(ours, theirs, reach) ** 2)
    return 2 * stats.t.sf(t, np.maximum(freedom, 1))


def uniformity(ours: Estimate, theirs: Estimate, p: np.ndarray, thin: int, reach: int) -> float:
    """p-value of "the p-values are uniform", over pixels that have noise; channels one by one, as they share samples."""
    noisy = np.hypot(ours.error, theirs.error) > 3 * unseen(ours, theirs, reach)
    channels = [p[::thin, ::thin, c][noisy[::thin, ::thin, c]] for c in range(p.shape[2])]
    tests = [stats.kstest(values, "uniform").pvalue for values in channels if len(values) >= 20]
    return min(1.0, len(tests) * min(tests)) if tests else 1.0


def compare(ours: dict[str, Estimate], theirs: dict[str, Estimate], thin: int = 1) -> Comparison:
    """Tests whether two sets of renders have the same mean.

    Args:
        ours, theirs: from `estimate`.
        thin: use every ``thin``-th pixel for the test of uniformity, which needs independent pixels; the width of the
            reconstruction filter in pixels where one side splats samples over neighbours.
    """
    shapes = [side["pixels"].mean.shape for side in (ours, theirs)]
    if shapes[0] != shapes[1]:
        raise ValueError(f"images of one shape are compared, got {shapes[0]} and {shapes[1]}")
    reach = max(3, thin)
    p = {scale: p_values(ours[scale], theirs[scale], reach if scale == "pixels" else 0) for scale in SCALES}
    whole = ours["whole"], theirs["whole"]
    level = np.maximum(abs(whole[1].mean), 1e-12)
    return Comparison(
        worst_p={scale: min(1.0, float(p[scale].min() * p[scale].size)) for scale in SCALES},
        worst_at={scale: tuple(int(i) for i in np.unravel_index(p[scale].argmin(), p[scale].shape)) for scale in SCALES},
        uniform_p=uniformity(ours["pixels"], theirs["pixels"], p["pixels"], thin, reach),
        bias=((whole[0].mean - whole[1].mean) / level).ravel(),
        bias_error=(np.hypot(whole[0].error, whole[1].error) / level).ravel(),
    )
