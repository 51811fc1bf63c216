"""Discrete distributions sampled in constant time without a branch."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor


class AliasTable(NamedTuple):
    """A discrete distribution over E entries."""

    pmf: Tensor  # (E,) probability of each entry
    threshold: Tensor  # (E,) keep the drawn entry below this, else take `other`
    other: Tensor  # (E,) int32

    def sample(self, u: Tensor) -> Tensor:
        """Entries, int32, for uniform numbers `u` in [0, 1)."""
        count = self.pmf.shape[0]
        scaled = u * count
        entry = scaled.to(torch.int32).clamp_max(count - 1)
        keep = (scaled - entry < self.threshold.index_select(0, entry)).to(torch.int32)
        other = self.other.index_select(0, entry)
        return other + keep * (entry - other)


def alias_table(weights: Tensor) -> AliasTable:
    """Builds the table for non-negative weights, not all zero.

    Reference: Vose 1991, "A Linear Algorithm for Generating Random Numbers with a Given Distribution".
    """
    pmf = weights.detach().to("cpu", torch.float64)
    pmf = pmf / pmf.sum()
    scaled = (pmf * len(pmf)).numpy()
    threshold, other = np.ones(len(scaled)), np.arange(len(scaled), dtype=np.int32)
    small = [i for i, value in enumerate(scaled) if value < 1.0]
    large = [i for i, value in enumerate(scaled) if value >= 1.0]
    remaining = scaled.copy()
    while small and large:
        little, big = small.pop(), large[-1]
        threshold[little], other[little] = remaining[little], big
        remaining[big] -= 1.0 - remaining[little]
        if remaining[big] < 1.0:
            small.append(large.pop())
    to = {"dtype": weights.dtype, "device": weights.device}
    return AliasTable(pmf.to(**to), torch.from_numpy(threshold).to(**to), torch.from_numpy(other).to(weights.device))
