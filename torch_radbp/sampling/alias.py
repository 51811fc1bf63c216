"""Discrete distributions sampled in constant time without a branch: the alias method."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor


class AliasTable(NamedTuple):
    """A discrete distribution over E entries."""

    pmf: Tensor  # (E,) probability of each entry
    threshold: Tensor  # (E,) the drawn entry is kept with this probability, else replaced by its alias, `other`
    other: Tensor  # (E,) int32
    count: Tensor  # () int64, E

    def sample(self, bits: Tensor, split: Tensor) -> Tensor:
        """Samples entries of the distribution, (N,) int32.

        A single number would not suffice: once 32 bits have picked one of a million entries, the rest of them is too
        coarse to decide between that entry and its other.

        Args:
            bits: (N,) int32 random bits, which pick an entry.
            split: (N,) uniform numbers in [0, 1), which decide between that entry and its other.
        """
        entry = (((bits.to(torch.int64) & 0xFFFFFFFF) * self.count) >> 32).to(torch.int32)
        keep = (split < self.threshold.index_select(0, entry)).to(torch.int32)
        other = self.other.index_select(0, entry)
        return other + keep * (entry - other)


def alias_table(weights: Tensor) -> AliasTable:
    """The alias table of non-negative weights, not all zero.

    Each entry is a bucket that holds the mean weight. Light entries are filled up, in order, from the first heavy entry with
    excess left. The last one filled may take more than there is; the heavy entry is then light itself and is filled from
    the next. Which entry fills which follows from prefix sums of the missing and of the excess weight.

    Reference: Huebschle-Schneider and Sanders 2019, "Parallel Weighted Random Sampling", section 4.
    """
    pmf = weights.detach().to("cpu", torch.float64)
    pmf = pmf / pmf.sum()
    threshold = pmf * len(pmf)
    other = torch.arange(len(pmf), device=pmf.device)
    light, heavy = (threshold <= 1.0).nonzero().squeeze(1), (threshold > 1.0).nonzero().squeeze(1)
    if len(light) and len(heavy):
        missing, excess = (1.0 - threshold[light]).cumsum(0), (threshold[heavy] - 1.0).cumsum(0)
        excess *= missing[-1] / excess[-1]  # equal but for rounding
        excess[-1] = missing[-1]
        before = torch.cat([missing.new_zeros(1), missing[:-1]])
        other[light] = heavy[torch.searchsorted(excess, before)]
        # For each heavy entry, the light one that takes more than is left.
        exhausting = torch.searchsorted(missing, excess[:-1], right=True).clamp_max(len(light) - 1)
        threshold[heavy[:-1]] = 1.0 - (missing[exhausting] - excess[:-1])
        threshold[heavy[-1]] = 1.0
        other[heavy[:-1]] = heavy[1:]
    to = {"dtype": weights.dtype, "device": weights.device}
    return AliasTable(pmf.to(**to), threshold.clamp(0.0, 1.0).to(**to), other.to(weights.device, torch.int32),
                      torch.tensor(len(pmf), device=weights.device))
