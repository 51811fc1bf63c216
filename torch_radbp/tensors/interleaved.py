"""Interleaved tables: all values that a lane reads of one vertex or texel lie in one row, and so in one cache line.

Tables are columns (struct of arrays) everywhere. Those of many entries may be columns of the same memory, of which compiled
loops read whole rows (`jit/lane/row_reads.py`); what few entries have is quicker to permute (`jit/lane/window.py`). Images
lie so already, and are read where they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from torch_radbp.tensors.differentiated import differentiated, tangent_of
from torch_radbp.tensors.record import leaves_of, with_leaves

LEAST = 256  # entries
AT_ONCE = 4  # entries of a row that are read together


class _MovedTable(torch.autograd.Function):
    """Moves a table to another place in memory, with its derivative."""

    @staticmethod
    def forward(ctx, table: Tensor, column: Tensor) -> Tensor:
        return column.view_as(column)

    @staticmethod
    def backward(ctx, adjoint: Tensor) -> tuple[Tensor, None]:
        return adjoint, None


def interleaved(record: Any) -> Any:
    """Interleaves the tables of 4-byte entries in a record; they stay contiguous if they are few, or in forward mode.

    Args:
        record: of tables, (N,) each, attached; None stays None.
    """
    leaves = [leaf.contiguous() if isinstance(leaf, Tensor) and leaf.itemsize != 4 else leaf for leaf in leaves_of(record)]
    places = [place for place, leaf in enumerate(leaves) if isinstance(leaf, Tensor) and leaf.itemsize == 4]
    for place, column in zip(places, columns([leaves[place] for place in places])):
        leaves[place] = column
    return with_leaves(record, leaves)


class _Columns(torch.autograd.Function):
    """The columns of interleaved rows as views; their gradients join to that of the rows without a copy if they are views,
    too.
    """

    @staticmethod
    def forward(ctx, rows: Tensor) -> tuple[Tensor, ...]:
        ctx.shape = rows.shape
        ctx.set_materialize_grads(False)
        return rows.detach().unbind(1)

    @staticmethod
    def backward(ctx, *adjoints: Tensor | None) -> Tensor:
        first = next(adjoint for adjoint in adjoints if adjoint is not None)
        if not torch.is_grad_enabled() and are_columns(adjoints, ctx.shape):
            return first.as_strided(ctx.shape, (ctx.shape[1], 1), first.storage_offset())
        return torch.stack([torch.zeros_like(first) if adjoint is None else adjoint for adjoint in adjoints], 1)


def are_columns(tables: Sequence[Tensor | None], shape: torch.Size) -> bool:
    """True if tables are exactly the columns of contiguous rows (N, C)."""
    if len(tables) != shape[1] or any(table is None for table in tables):
        return False
    start, memory = tables[0].storage_offset(), tables[0].untyped_storage().data_ptr()
    return all(table.shape == shape[:1] and table.stride() == (shape[1],) and table.storage_offset() == start + place
               and table.untyped_storage().data_ptr() == memory for place, table in enumerate(tables))


def columns_of_rows(rows: Tensor) -> tuple[Tensor, ...]:
    """The columns, (N,) each, of rows (N, C), attached; views if they are many and of 4-byte entries."""
    if rows.itemsize != 4 or len(rows) < LEAST:
        return tuple(column.contiguous() for column in rows.unbind(1))
    return _Columns.apply(rows) if rows.requires_grad and tangent_of(rows) is None else rows.unbind(1)


def columns(tables: Sequence[Tensor]) -> list[Tensor]:
    """Interleaves tables, (N,) each of 4 bytes, to columns of rows; attached."""
    entries, count = len(tables[0]) if tables else 0, len(tables)
    if count < 2 or entries < LEAST or any(tangent_of(table) is not None for table in tables):
        return [table.contiguous() for table in tables]
    width = count if count <= AT_ONCE else -(-count // AT_ONCE) * AT_ONCE
    rows = torch.empty(entries, width, dtype=torch.float32, device=tables[0].device)
    views = [rows[:, place].view(table.dtype) for place, table in enumerate(tables)]
    for table, column in zip(tables, views):
        column.copy_(table.detach())
    return [_MovedTable.apply(table, column) if differentiated(table) else column for table, column in zip(tables, views)]
