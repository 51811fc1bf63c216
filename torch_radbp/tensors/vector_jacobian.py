"""Vector-Jacobian products by torch's autograd, and the adjoints of table look-ups."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.tensors.lookup import Tap


class TableAdjoint(NamedTuple):
    """The adjoint of one table look-up, (N,) each, before it is scattered into the table's gradient."""

    index: Tensor  # int32
    adjoint: Tensor


def vector_jacobian_product(outputs: list[Tensor], inputs: list[Tensor], adjoints: list[Tensor]) -> tuple:
    """The adjoints of `inputs` by torch's autograd; None where nothing depends on them."""
    dependent = [(output, adjoint) for output, adjoint in zip(outputs, adjoints) if output.requires_grad]
    if not dependent or not inputs:
        return (None,) * len(inputs)
    outputs, adjoints = zip(*dependent)
    return torch.autograd.grad(outputs, inputs, adjoints, allow_unused=True)


def zeros_unless(adjoint: Tensor | None, like: Tensor) -> Tensor:
    """The adjoint, or zeros if it is None."""
    return torch.zeros_like(like) if adjoint is None else adjoint


def table_adjoints(tap: Tap, adjoints: Iterator[Tensor | None]) -> list[TableAdjoint]:
    """Pairs the look-ups of a table with their adjoints.

    Args:
        tap: of the table.
        adjoints: its next items are those of the table's gathered entries.
    """
    found = []
    for read in tap.reads:
        adjoint = next(adjoints)
        parts = [part for part in (adjoint, read.found) if part is not None]
        if parts:
            found.append(TableAdjoint(read.index, sum(parts[1:], parts[0])))
    return found
