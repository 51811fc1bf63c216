"""Unbiased thinning of samples: some are kept and stand for all.

Each is kept with a probability in proportion to what it counts for, and counts as much more as it was unlikely to be kept:
sums keep their expectation. Large ones, which make the noise, are all kept.

References: Madow 1949, "On the Theory of Systematic Sampling II"; Veach 1997, section 10.4 (roulette).
"""

from __future__ import annotations

import torch
from torch import Tensor

from torch_radbp.sampling.running_sum import running_sum

TURNS = 4  # of looking for the probability of small ones: more large ones are certain after each


def chances(size: Tensor, most: int) -> Tensor:
    """The probabilities with which to keep samples, in proportion to size, so that about `most` are kept; 0 for size 0.

    Args:
        size: (N,) float64, not negative.
        most: an upper bound of the sum of probabilities, if more sizes are not 0; else all of these are kept.

    Returns:
        (N,) in [0, 1], in proportion to `size`, except where that would exceed 1.
    """
    chance = torch.zeros_like(size)
    for _ in range(TURNS):
        certain = chance >= 1.0
        left = torch.where(certain, 0.0, size)
        free = most - certain.sum()
        chance = torch.where(certain, 1.0, (left * (free / left.sum().clamp_min(1e-300))).clamp_max(1.0))
    return chance


def thinned(chance: Tensor, u: Tensor) -> Tensor:
    """The indices, int64, of the samples kept by systematic sampling with given probabilities.

    Args:
        chance: (N,) float64.
        u: () uniform in [0, 1).
    """
    reached = (running_sum(chance) + u).floor()
    before = torch.cat([u.floor().reshape(1), reached[:-1]])
    return (reached > before).nonzero().squeeze(1)
