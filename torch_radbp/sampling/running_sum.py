"""Prefix sums of weights, the tables that binary searches look into."""

from __future__ import annotations

import torch
from torch import Tensor


def sums_in_any_order(device: torch.device) -> bool:
    """True if torch's prefix sums on a device are not deterministic; torch may be told to refuse these."""
    return device.type != "cpu"


def running_sum(weights: Tensor, dim: int = 0, out: Tensor | None = None) -> Tensor:
    """Prefix sums along a dimension, deterministic under `torch.use_deterministic_algorithms`.

    Args:
        weights: non-negative, of any shape.
        dim: along which dimension.
        out: written into if given; it may be the weights.

    Reference: Hillis and Steele 1986, "Data parallel algorithms" (sums of 2, 4, 8, ... neighbours).
    """
    if not (torch.are_deterministic_algorithms_enabled() and sums_in_any_order(weights.device)):
        return torch.cumsum(weights, dim, out=out)
    sums, step = weights.movedim(dim, -1), 1
    while step < sums.shape[-1]:
        sums = torch.cat([sums[..., :step], sums[..., step:] + sums[..., :-step]], -1)
        step *= 2
    sums = sums.cummax(-1).values.movedim(-1, dim)  # neighbours are rounded differently, but a search needs them sorted
    return sums if out is None else out.copy_(sums)
