"""The gradient of a read of a table: each lane's adjoint is added to the entry that it has read."""

from __future__ import annotations

from torch import Tensor

MOST_BLOCKS, MOST_PARTIAL_SUMS = 256, 1 << 16


def scatter_add(gradient: Tensor, index: Tensor, adjoint: Tensor, places: dict[tuple[int, int], Tensor]) -> None:
    """Adds each lane's adjoint to its entry of a table's gradient.

    Millions of lanes may add to one entry: one float32 sum would lose what is small against the total (2% of the lamp's
    gradient at 4 million paths). So the total is float64, and small tables are summed in blocks first, in parallel.

    Args:
        gradient: (K,) float64, written into.
        index: (N,) int32.
        adjoint: (N,).
        places: what was made of indices before, for several tables are read at the same ones.
    """
    entries = len(gradient)
    blocks = max(1, min(MOST_BLOCKS, len(index), MOST_PARTIAL_SUMS // entries))
    whole = len(index) // blocks * blocks
    if (id(index), blocks) not in places:
        places[id(index), blocks] = index[:whole].view(blocks, -1).long()
    place = places[id(index), blocks]
    if blocks == 1:
        gradient.scatter_add_(0, place[0], adjoint.to(gradient.dtype))
        return
    partial = adjoint.new_zeros(blocks, entries)
    partial.scatter_add_(1, place, adjoint[:whole].view(blocks, -1))
    gradient += partial.sum(0, dtype=gradient.dtype)
    gradient.index_add_(0, index[whole:], adjoint[whole:].to(gradient.dtype))
