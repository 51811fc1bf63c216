"""Table look-ups by lane that record what was gathered and where, for local derivatives.

The derivative of a gather is a scatter-add. The local vector-Jacobian product of a bounce never scatters into a table: a
tapped table returns what it gathers as leaves and remembers the indices, and the sweep adds the adjoints of the leaves to
one gradient buffer afterwards. Plain autograd (the oracle) reads plain tensors.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.tensors.differentiated import differentiated
from torch_radbp.tensors.record import leaves_of, mapped, with_leaves
from torch_radbp.tensors.torch_internals import without_compiler
from torch_radbp.tensors.vec import gather


class Read(NamedTuple):
    """One recorded gather from a table."""

    index: Tensor  # (N,) int32
    leaf: Tensor  # (N,) the gathered entries, as a leaf of autograd
    found: Tensor | None  # (N,) a part of the adjoint of these that is computed elsewhere


class Tap:
    """A table that returns gathered entries as autograd leaves, and lists all gathers in `reads`."""

    def __init__(self, table: Tensor):
        self.table = table
        self.reads: list[Read] = []

    def read(self, index: Tensor, found: Tensor | None = None) -> Tensor:
        """Gathers the entries at `index`, and records it; `found`: a part of their adjoint that is computed elsewhere."""
        leaf = gather(self.table, index).detach().requires_grad_()
        self.reads.append(Read(index, leaf, found))
        return leaf


def tapped(node, wanted: tuple[bool, ...], place: int, taps: list[Tap]):
    """Replaces tables of a record by `Tap`s, which record gathers.

    Args:
        node: the record, or a part of it.
        wanted: of each leaf, counted as `leaves_of` does, whether to tap it.
        place: the number of the first leaf of `node`.
        taps: filled in, in order.

    Returns:
        The record, and the number of the leaf after it.
    """
    if isinstance(node, tuple):
        parts = []
        for part in node:
            part, place = tapped(part, wanted, place, taps)
            parts.append(part)
        return type(node)(*parts) if hasattr(node, "_fields") else tuple(parts), place
    if wanted[place]:
        node = Tap(node)
        taps.append(node)
    return node, place + 1


class GatheredExactly(torch.autograd.Function):
    """A gather whose gradient is summed in float64: a float32 sum loses small terms."""

    @staticmethod
    def forward(table: Tensor, index: Tensor) -> Tensor:
        return gather(table, index)

    @staticmethod
    def setup_context(ctx, inputs: tuple[Tensor, Tensor], output: Tensor) -> None:
        table, index = inputs
        ctx.save_for_backward(index)
        ctx.save_for_forward(index)
        ctx.entries = len(table)

    @staticmethod
    @without_compiler()
    def backward(ctx, adjoint: Tensor) -> tuple[Tensor, None]:
        index, = ctx.saved_tensors
        total = adjoint.new_zeros(ctx.entries, dtype=torch.float64).index_add_(0, index, adjoint.double())
        return total.to(adjoint.dtype), None

    @staticmethod
    def jvp(ctx, tangent: Tensor, _: None) -> Tensor:
        return gather(tangent, *ctx.saved_tensors)


def untapped(record):
    """A record in which every `Tap` is replaced by its table."""
    return mapped(record, lambda leaf: leaf.table if isinstance(leaf, Tap) else leaf)


class SummedTable:
    """A table whose gradient, in plain autograd, is summed in float64."""

    def __init__(self, table: Tensor):
        self.table = table

    def read(self, index: Tensor) -> Tensor:
        """Gathers the entries at `index`."""
        return GatheredExactly.apply(self.table, index)


def summed(record):
    """Replaces the tables of a record that require a gradient by `SummedTable`s."""
    return with_leaves(record, [SummedTable(leaf) if isinstance(leaf, Tensor) and leaf.ndim == 1 and differentiated(leaf)
                                else leaf for leaf in leaves_of(record)])


def lookup(table, index: Tensor):
    """Gathers entries of a table, or of each table of a record, at int32 `index` (N,)."""
    if isinstance(table, (Tap, SummedTable)):
        return table.read(index)
    if isinstance(table, tuple):
        parts = [lookup(part, index) for part in table]
        return type(table)(*parts) if hasattr(table, "_fields") else tuple(parts)
    return None if table is None else gather(table, index)
