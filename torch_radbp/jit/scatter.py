"""Scatter-add: adds numbers of lanes to table entries; the derivative of a gather.

Totals are float64: millions of lanes may add to one entry, and a float32 sum would lose what is small against the total.
A few tables that are read at the same index are written together.

Additions to one entry wait for each other. So totals may come in several copies, of which neighbouring lanes take different
ones; whoever reads the totals sums the copies. How it is done is the target's: `cpu/cpu_scatter.py` for the processor,
`nvidia/nvptx_lanes.py` for GPUs, torch elsewhere.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch

from torch_radbp.jit.recording.addition import MOST_TABLES, PAGE_BITS, SCALARS, Addition, Sums
from torch_radbp.jit.target import target_of

__all__ = ["MOST_TABLES", "PAGE_BITS", "Addition", "Sums", "copies", "scatter_add"]


def copies(entries: int, device: torch.device) -> int:
    """The best number of copies in which a table of gradients is summed, so that lanes rarely wait for each other."""
    return target_of(device).copies(entries)


def scatter_add(additions: Sequence[Addition]) -> None:
    """Scatter-adds numbers of the lanes to tables.

    On the CPU it is done in the order of the lanes, so that the sums are the same each time. On a GPU it is done in any
    order, so that the last bits of float64 differ from time to time, unless torch is told to be deterministic
    (`torch.use_deterministic_algorithms`): then torch sorts the lanes by entry and sums each entry's in order, slower.

    Args:
        additions: of equally many lanes, tensors on one device. An index must be of an entry, which is not checked.

    Raises:
        ValueError: if tensors of one addition differ in length or device, or have a dtype that `Addition` does not name.
    """
    if not additions or not (lanes := additions[0].index.numel()):
        return
    device = additions[0].index.device
    for addition in additions:
        _check(addition, lanes, device)
    target_of(device).scatter_add([addition.contiguous() for addition in additions], lanes)


def _check(addition: Addition, lanes: int, device: torch.device) -> None:
    """Raises ValueError unless the tensors of an addition fit together, as `scatter_add` says."""
    index, numbers, sums = addition
    dtype = numbers[0].dtype
    right = (len(numbers) == len(sums.totals) and index.dtype == torch.int32 and index.numel() == lanes and dtype in SCALARS
             and index.device == sums.device == device
             and all([number.dtype == dtype and number.numel() == lanes and number.device == device for number in numbers]))
    if not right:
        found = [(tuple(tensor.shape), tensor.dtype, str(tensor.device)) for tensor in (index, *numbers)]
        raise ValueError(f"an addition takes int32 indices of {lanes} lanes and numbers for each of {len(sums.totals)} "
                         f"tables, all float32 or all float64, on {device}; got {found} for sums on {sums.device}")
