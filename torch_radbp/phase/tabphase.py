"""A phase function by a table of values."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.interface.phase import CosineKind, PhaseFunction
from torch_radbp.plugin import register
from torch_radbp.plugin.domain import AMOUNT, Domain
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.vec import TINY
from torch_radbp.texture.spectrum import numbers

EVEN_SHARE = 0.02  # of directions, sampled evenly: what is 0 in some has its derivative there


class TabulatedTable(NamedTuple):
    """A tabulated phase function: values at N equidistant cosines from -1 to 1, attached."""

    density: Tensor  # (N,) over the cosine, integrates to 1
    sampled: Tensor  # (N,) the density that is sampled
    below: Tensor  # (N,) its integral up to each cosine


@dataclass(frozen=True)
class TabulatedKind(CosineKind):
    """The phase function p(cos) / (2 pi), linear between a table's entries; its distribution is inverted by bisection."""

    entries: int

    def of_cosine(self, table: TabulatedTable, cosine: Tensor) -> tuple[Tensor, Tensor]:
        place = ((cosine + 1.0) * (0.5 * (self.entries - 1))).clamp(0.0, self.entries - 1.0)
        left = torch.floor(place.detach()).clamp_max(self.entries - 2.0)
        row, share = left.to(torch.int32), place - left
        value, pdf = ((lookup(column, row) * (1.0 - share) + lookup(column, row + 1) * share) * (0.5 / math.pi)
                      for column in (table.density, table.sampled))
        return value, pdf

    def sample_cosine(self, table: TabulatedTable, u: Tensor) -> Tensor:
        # The last entry with no more than u below it.
        row, step = torch.zeros_like(u, dtype=torch.int32), 1 << max(self.entries - 2, 0).bit_length()
        while step := step // 2:
            further = (row + step).clamp_max(self.entries - 2)
            row = torch.where(lookup(table.below, further) <= u, further, row)
        # The root of first t + (second - first) t^2 / 2 = rest, in units of the distance between entries.
        distance = 2.0 / (self.entries - 1)
        rest = (u - lookup(table.below, row)).clamp_min(0.0) / distance
        first, second = lookup(table.sampled, row), lookup(table.sampled, row + 1)
        root = torch.sqrt((first * first + 2.0 * (second - first) * rest).clamp_min(TINY))
        share = (2.0 * rest / (first + root).clamp_min(TINY)).clamp(0.0, 1.0)
        return ((row.to(u.dtype) + share) * distance - 1.0).clamp(-1.0, 1.0)


@register("phase", "tabphase")
class TabulatedPhase(PhaseFunction):
    """Scatters by a table of values at equidistant cosines, from -1 to 1, of the angle by which light turns; linear between
    these, and made to integrate to 1.

    Parameters: `values`, (N,). Derivatives: with respect to them.

    Args:
        values: at least two, a text with commas or blanks between them, or an array; the first of light that turns back, the
            last of light that goes straight on.

    Raises:
        ValueError: if there are less than two, if one is negative or not finite, or all are 0.
    """

    def __init__(self, *, values: str | Tensor):
        super().__init__()
        values = numbers("values", values)
        if len(values) < 2:
            raise ValueError(f"values of tabphase must be at least two, got {len(values)}")
        self.freeze("values", values)
        if not bool((self.values.detach() > 0).any()):
            raise ValueError("values of tabphase must not all be 0")

    def domains(self) -> dict[str, Domain]:
        return {"values": AMOUNT._replace(shapes=(("N",),), floor=0.0)}

    def kind(self) -> TabulatedKind:
        return TabulatedKind(len(self.values))

    def row(self) -> TabulatedTable:
        # What a step of an optimiser has taken below 0 counts as 0, with its derivative.
        values = self.values + (self.values.detach().clamp_min(0.0) - self.values.detach())
        density = values / areas(values).sum().clamp_min(TINY)
        sampled = density * (1.0 - EVEN_SHARE) + 0.5 * EVEN_SHARE
        return TabulatedTable(density, sampled, torch.nn.functional.pad(areas(sampled).cumsum(0), (1, 0)))


def areas(density: Tensor) -> Tensor:
    """The integrals between the entries of a table of N, (N - 1,), attached."""
    return (density[:-1] + density[1:]) / (len(density) - 1)
