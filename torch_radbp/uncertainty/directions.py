"""Directions in the space of parameters that images do not tell, in words."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

ALIKE = 0.1  # how far apart two changes may be, relative to the larger, to be called the same


class Direction(NamedTuple):
    """A direction of parameters along which images change by less than can be told from noise."""

    change: Tensor  # (n,) in units of the parameters; its largest entry in units of its own deviation is 1
    words: str


def sparse_basis(vectors: Tensor) -> Tensor:
    """A basis of the span of the columns of (n, k), with as many zeros as elimination finds; largest entries are 1."""
    rows = vectors.T.clone()
    for pivot in range(len(rows)):
        place = int(rows[pivot].abs().argmax())
        rows[pivot] = rows[pivot] / rows[pivot, place].clone()
        others = torch.arange(len(rows)) != pivot
        rows[others] -= rows[others, place, None] * rows[pivot]
    rows = rows / rows.abs().amax(1, keepdim=True)
    return torch.where(rows.abs() < 1e-6, 0.0, rows).T


def in_words(change: Tensor, values: Tensor, names: list[str], sizes: Tensor) -> str:
    """Describes a direction of parameters along which images do not change, by what they still tell of these.

    Args:
        change: (n,) in units of the parameters.
        values: (n,) of the parameters, to tell products and ratios by.
        names: of the n entries.
        sizes: (n,) the deviation of each parameter by itself, to tell which entries of the change matter.
    """
    share = (change / sizes).abs()
    moved = [int(index) for index in (share > 0.05 * share.max()).nonzero()]
    if len(moved) == 1:
        return f"{names[moved[0]]} is not seen at all"
    if len(moved) == 2:
        return pair_in_words(moved[0], moved[1], change, values, names)
    relative = change[moved] / values[moved]
    if bool(relative.isfinite().all()) and bool((relative.abs() > (1 - ALIKE) * relative.abs().max()).all()):
        up = [names[index] for index, sign in zip(moved, relative.tolist(), strict=True) if sign * float(relative[0]) > 0]
        down = [names[index] for index in moved if names[index] not in up]
        if down:
            return f"{' and '.join(up)} up and {' and '.join(down)} down by one factor make the same images"
        return f"{' and '.join(up)} by one factor make the same images"
    return " ".join(f"{float(change[index]):+.3g} {names[index]}" for index in moved) + " makes the same images"


def pair_in_words(first: int, second: int, change: Tensor, values: Tensor, names: list[str]) -> str:
    """What images still tell of two parameters that change along a direction: a product, a ratio, ...; see `in_words`."""
    both = f"{names[first]} and {names[second]}"
    relative = change / values
    for kinds, (a, b) in ((("product", "ratio"), relative[[first, second]].tolist()),
                          (("sum", "difference"), change[[first, second]].tolist())):
        if 0 < max(abs(a), abs(b)) < float("inf") and abs(abs(a) - abs(b)) <= ALIKE * max(abs(a), abs(b)):
            return f"{both} only as a {kinds[0] if a * b < 0 else kinds[1]}"
    power = -float(relative[first] / relative[second])
    if 0 < abs(power) < float("inf"):
        return f"{both} only as the first times the second to the power {power:.2g}"
    return f"{both} only but for {float(change[first]):+.3g} of the first and {float(change[second]):+.3g} of the second"
