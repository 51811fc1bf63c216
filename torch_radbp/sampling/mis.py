"""Multiple importance sampling."""

from __future__ import annotations

import torch
from torch import Tensor


def power_heuristic(pdf: Tensor, other: Tensor) -> Tensor:
    """Weight of a sample drawn with density `pdf` where the other technique has density `other`.

    Reference: Veach 1997, "Robust Monte Carlo Methods for Light Transport Simulation", section 9.2.4, exponent 2.
    """
    ratio = other / torch.where(pdf > 0, pdf, 1.0)
    return torch.where(pdf > 0, 1.0 / (1.0 + ratio * ratio), 0.0)
