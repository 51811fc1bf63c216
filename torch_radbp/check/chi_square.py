"""Chi-square tests of samples against expected counts."""

from __future__ import annotations

import torch
from torch import Tensor

# A right sampler fails one test in a million; the seeds are fixed, so that it either does or does not.
SIGNIFICANCE = 1e-6
FEWEST = 8  # expected samples of a cell; smaller cells are pooled


def p_value(observed, expected, constraints: int = 1, uncertainty=0.0) -> float:
    """The probability of a worse fit by chance; 0 if there are samples where none are expected.

    Args:
        observed: counts, a tensor or an array.
        expected: expected counts, same shape, same sum up to what falls outside of all cells.
        constraints: degrees of freedom that the expectation takes from the data.
        uncertainty: of the expected counts, which adds to the variance; same shape, or one number.

    Raises:
        ValueError: if nothing was observed, or an expected count is not finite.
    """
    counts, means = (torch.as_tensor(each, dtype=torch.float64).flatten() for each in (observed, expected))
    uncertain = torch.as_tensor(uncertainty, dtype=torch.float64).expand(torch.as_tensor(expected).shape).flatten()
    if not counts.sum() > 0 or not bool(torch.isfinite(means).all()):
        raise ValueError(f"observed must have samples and expected be finite, got sums {counts.sum():g} and {means.sum():g}")
    order = means.argsort()
    small = torch.zeros_like(order, dtype=torch.bool)
    small[order] = means[order].cumsum(0) < FEWEST
    counts, means, uncertain = (pooled(each, small) for each in (counts, means, uncertain))
    if bool((counts[means == 0] > 0).any()):
        return 0.0
    there = means > 0
    counts, means, uncertain = counts[there], means[there], uncertain[there]
    statistic = ((counts - means) ** 2 / (means + uncertain**2)).sum()
    freedom = torch.tensor(max(len(means) - constraints, 1), dtype=torch.float64)
    return float(torch.special.gammaincc(freedom / 2, statistic / 2))


def pooled(values: Tensor, small: Tensor) -> Tensor:
    """The entries that are not small, and the sum of the small ones."""
    return torch.cat([values[~small], values[small].sum()[None]])
