"""Columns of a Jacobian that change no part of the images in common: one product with their sum gives them all.

A colour has three numbers, of which each changes one channel of the images, and a gain changes one image. So one image in
forward mode is enough for the three, and for all gains.

Reference: Curtis, Powell and Reid 1974, "On the estimation of sparse Jacobian matrices".
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

ROUNDING = 1e-3  # relative to the sum of what columns add to an entry of a product
TRIALS = 2  # how often columns may turn out not to be separate, before they are no longer taken together


class SeparateColumns(NamedTuple):
    """Groups of columns of a Jacobian, (M, n), that one product gives together, and the image parts that each changes."""

    groups: list[list[int]]  # of columns that change no part in common
    changed: Tensor  # (P, n) bool, whether a column has an entry in a part
    failures: int = 0  # how often columns were not separate

    @staticmethod
    def of(jacobian: Tensor, parts: Tensor, before: SeparateColumns | None = None) -> SeparateColumns:
        """The groups of the columns of a Jacobian: each column joins the first that it shares no part with.

        Args:
            jacobian: (M, n).
            parts: (M,) int64, the image part to which each row belongs.
            before: the groups of an earlier Jacobian, which proved wrong; None: there were none.
        """
        size = jacobian.shape[1]
        changed = torch.zeros(int(parts.max()) + 1, size, dtype=torch.bool, device=jacobian.device)
        for column in range(size):
            changed[parts[jacobian[:, column] != 0], column] = True
        if before is not None and before.changed.shape == changed.shape:
            changed |= before.changed
        shared = (changed.T.double() @ changed.double() > 0).tolist()
        groups: list[list[int]] = []
        for column, meets in enumerate(shared):
            group = next((group for group in groups if not any(meets[other] for other in group)), None)
            if group is None:
                groups.append([column])
            else:
                group.append(column)
        return SeparateColumns(groups, changed, 0 if before is None else before.failures + 1)

    @property
    def save(self) -> bool:
        """True if fewer products than columns are needed."""
        return self.failures < TRIALS and len(self.groups) + 1 < self.changed.shape[1]

    def jacobian(self, product: Callable[[Tensor], Tensor], parts: Callable[[], Tensor]) -> Tensor | None:
        """J, (M, n), by a product for each group, and one that tests whether the columns of groups are still separate.

        Args:
            product: J v of v, (n,): (M,) float64.
            parts: of the rows of the last product, (M,) int64.

        Returns:
            None if they are not separate.
        """
        size, device = self.changed.shape[1], self.changed.device
        units = torch.eye(size, dtype=torch.float64, device=device)
        columns: dict[int, Tensor] = {}
        for group in self.groups:
            together, of = product(units[group].sum(0)), parts()
            if int(of.max()) + 1 != len(self.changed):
                return None
            columns |= {column: torch.where(self.changed[of, column], together, 0.0) for column in group}
        found = torch.stack([columns[column] for column in range(size)], 1)
        # Entries of a wrong column would be multiplied by another number than their own.
        generator = torch.Generator().manual_seed(size)
        weights = torch.randn(size, generator=generator, dtype=torch.float64).to(device)
        told, true = found @ weights, product(weights)
        room = ROUNDING * (found.abs() @ weights.abs()) + 1e-6 * true.abs().max()
        return found if bool(((told - true).abs() <= room).all()) else None


def parts_of(shapes: Sequence[torch.Size], device: torch.device) -> Tensor:
    """The part to which each number of some tensors belongs, (M,) int64: a channel of an image, a vector's entry, a row."""
    found, first = [], 0
    for shape in shapes:
        lengths = shape[:-2] if len(shape) > 2 else shape[:1]
        count = lengths.numel()
        numbers = torch.arange(first, first + count, device=device)
        found.append(numbers.repeat_interleave(shape.numel() // max(count, 1)))
        first += count
    return torch.cat(found)
