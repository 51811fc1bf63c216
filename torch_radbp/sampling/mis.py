"""Multiple importance sampling: the power heuristic."""

from __future__ import annotations

from torch import Tensor


def power_heuristic(pdf: Tensor, other: Tensor) -> Tensor:
    """The MIS weight of a sample drawn with density `pdf` > 0 where the other technique has density `other`.

    An infinite `pdf` (of ideal specular scattering) gives weight 1.

    Reference: Veach 1997, "Robust Monte Carlo Methods for Light Transport Simulation", section 9.2.4, exponent 2.
    """
    ratio = other / pdf
    return (1.0 + ratio * ratio).reciprocal()
