"""Welding: vertices of a mesh at the same position up to rounding, as along seams of uv."""

from __future__ import annotations

import math

import torch
from torch import Tensor

WELDED = 1e-5  # vertices nearer than about this share of the mesh's extent count as one
HASH, SLOTS_OF_VERTEX = 0x1E3779B97F4A7C15, 4  # the multiplier of a hash, and how many values it has for each vertex
AT_ONCE = 1 << 16  # vertices, so that little memory is touched for the first time


def weld_size(vertices: Tensor) -> float:
    """The distance below which vertices of a mesh, (V, 3), are welded."""
    extent = float((vertices.amax(0) - vertices.amin(0)).max())
    # Powers of ten, because coordinates that people write are multiples of them.
    return 10.0 ** math.floor(math.log10(extent * WELDED)) if extent > 0.0 else 1.0


def cells_of(vertices: Tensor, size: float) -> tuple[Tensor, Tensor]:
    """The cells of the vertices, (V, 3), in two grids of this cell size; (V,) int64 each.

    One grid is shifted by half a cell against the other, so that vertices at the same place, up to rounding, share a cell
    of at least one of them.
    """
    first = vertices.amin(0).double()
    cells = torch.empty(2, len(vertices), dtype=torch.int64, device=vertices.device)
    for some, cells_of_some in zip(vertices.split(AT_ONCE), cells.split(AT_ONCE, 1)):
        places = (some.double() - first) / size
        for shift, cell in zip((0.5, 1.0), cells_of_some):
            x, y, z = torch.floor(places + shift).long().unbind(1)
            cell.copy_((x << 42) | (y << 21) | z)
    return cells[0], cells[1]


def welded(cells: tuple[Tensor, Tensor]) -> Tensor | None:
    """For each vertex the first vertex at the same position, (V,) int32, by `cells_of`; None: all are distinct."""
    # Most vertices lie apart: only those are sorted that the numbers of their cells do not tell from others at once.
    near = (may_be_shared(cells[0]) | may_be_shared(cells[1])).nonzero().squeeze(1)
    numbers = label = torch.arange(len(near), device=near.device)
    groups = [torch.unique(cell[near], return_inverse=True) for cell in cells]
    if all(len(cells_of_grid) == len(numbers) for cells_of_grid, _ in groups):
        return None
    for _, group in groups * 2:
        label = torch.full_like(numbers, len(numbers)).scatter_reduce(0, group, label, "amin")[group]
    if torch.equal(label, numbers):
        return None
    every = torch.arange(len(cells[0]), dtype=torch.int32, device=near.device)
    return every.index_copy(0, near, near[label].int())


def may_be_shared(cell: Tensor) -> Tensor:
    """(V,) bool, True for vertices whose cell (V,) may contain others; never False where it does."""
    slots = 1 << (SLOTS_OF_VERTEX * len(cell)).bit_length()
    slot = ((cell * HASH) >> 32) & (slots - 1)
    return (torch.bincount(slot, minlength=slots) > 1)[slot]
