"""Chi-square tests of samples against expected counts."""

from __future__ import annotations

import numpy as np
from scipy import stats

# A right sampler fails one test in a million; the seeds are fixed, so that it either does or does not.
SIGNIFICANCE = 1e-6
FEWEST = 8  # expected samples of a cell; smaller cells are pooled


def p_value(observed: np.ndarray, expected: np.ndarray, constraints: int = 1) -> float:
    """The probability of a worse fit by chance.

    Args:
        observed: counts.
        expected: expected counts, same shape, same sum up to what falls outside of all cells.
        constraints: degrees of freedom that the expectation takes from the data.
    """
    observed, expected = observed.ravel().astype(float), expected.ravel().astype(float)
    assert observed.sum() > 0 and np.isfinite(expected).all()
    assert observed[expected == 0].sum() == 0, "samples where the density is zero"
    order = np.argsort(expected)
    small = order[np.cumsum(expected[order]) < FEWEST]
    keep = np.setdiff1d(order, small)
    counts, means = observed[keep], expected[keep]
    if expected[small].sum() > 0:
        counts, means = np.append(counts, observed[small].sum()), np.append(means, expected[small].sum())
    statistic = ((counts - means) ** 2 / np.maximum(means, 1e-300)).sum()
    return float(stats.chi2.sf(statistic, len(means) - constraints))
