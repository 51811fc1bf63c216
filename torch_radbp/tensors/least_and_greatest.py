"""Whether all values of a tensor are finite, without a copy of it."""

from __future__ import annotations

from torch import Tensor, stack


def least_and_greatest(tensor: Tensor) -> Tensor:
    """(2,) the least and the greatest value, detached; zeros if there is none.

    They are infinite or NaN if any value is, and are found in one pass over the tensor.
    """
    return stack(tensor.detach().aminmax()) if tensor.numel() else tensor.new_zeros(2)
