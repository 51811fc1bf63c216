"""Adds patches to images: each lane counts in all pixels of a rectangle, in each by a weight of its row and of its column.

How it is done is the target's: `cpu/cpu_patches.py` for the processor, scatter-additions elsewhere.
"""

from __future__ import annotations

import torch
from torch import Tensor

from torch_radbp.jit.recording.addition import SCALARS, VALUES, Patches
from torch_radbp.jit.target import target_of

__all__ = ["CHANNELS", "Patches", "add_patches"]

CHANNELS = VALUES + 1  # of totals; the last is not used


def add_patches(patches: Patches, totals: Tensor) -> None:
    """Adds the values of lanes, weighted, to the pixels of their patches.

    On the CPU it is done in the order of the lanes, so that the sums are the same each time. On a GPU as by `scatter_add`.

    Args:
        patches: of N lanes. That all their pixels are in the image is not checked.
        totals: (rows, columns, CHANNELS) float64, contiguous, added to.

    Raises:
        ValueError: if tensors differ in length, dtype or device, or there are no weights.
    """
    first, values, down, across = patches
    numbers, lanes, device = [*values, *down, *across], len(first), totals.device
    right = (len(values) == VALUES and down and across and totals.dim() == 3 and totals.shape[2] == CHANNELS
             and totals.is_contiguous() and totals.dtype == torch.float64 and first.dtype == torch.int32
             and first.device == device and numbers[0].dtype in SCALARS
             and all([number.dtype == numbers[0].dtype and number.shape == first.shape and number.device == device
                      for number in numbers]))
    if not right:
        found = [(tuple(tensor.shape), tensor.dtype, str(tensor.device)) for tensor in (first, *numbers, totals)]
        raise ValueError(f"patches have int32 first pixels, {VALUES} values and weights of rows and columns of {lanes} "
                         f"lanes, all float32 or all float64, for contiguous float64 totals (rows, columns, {CHANNELS}) on "
                         f"the same device; got {found}")
    if lanes:
        target_of(device).add_patches(patches.contiguous(), totals)
