"""The interface between phase functions and media.

A phase function has two parts, as a material has: its `PhaseKind`, a hashable value that names the functions, and a row of
numbers, attached to its parameters. It tells which share of the scattered light goes into each direction, and integrates
to 1.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from torch_radbp.plugin import Phase
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.vec import TINY, Frame, Vec3, dot

Table = Any  # a NamedTuple of columns


@dataclass(frozen=True)
class PhaseKind(ABC):
    """The functions of one kind of phase function; all tensors are (N,), at points `p` in the world.

    `wi` and `wo` are unit directions in the world, towards where a path comes from and in which it goes on.
    """

    @abstractmethod
    def eval_pdf(self, table: Table, p: Vec3, wi: Vec3, wo: Vec3) -> tuple[Tensor, Tensor]:
        """The phase function, 1 / sr, and the density over solid angle of `sample`; attached."""

    @abstractmethod
    def sample(self, table: Table, p: Vec3, wi: Vec3, u: Tensor, v: Tensor) -> Vec3:
        """Samples directions in which paths go on, by two random numbers; attached."""

    def projected_area(self, table: Table, p: Vec3, wi: Vec3) -> Tensor | None:
        """The factor of the extinction along a direction, attached; None: the same along all."""
        return None


@dataclass(frozen=True)
class CosineKind(PhaseKind):
    """A phase function that depends on the cosine of the scattering angle alone: 1 is straight on."""

    @abstractmethod
    def of_cosine(self, table: Table, cosine: Tensor) -> tuple[Tensor, Tensor]:
        """The phase function, 1 / sr, and the density over solid angle of `sample_cosine`; attached."""

    @abstractmethod
    def sample_cosine(self, table: Table, u: Tensor) -> Tensor:
        """Samples cosines by random numbers; attached."""

    def eval_pdf(self, table: Table, p: Vec3, wi: Vec3, wo: Vec3) -> tuple[Tensor, Tensor]:
        return self.of_cosine(table, -dot(wi, wo))

    def sample(self, table: Table, p: Vec3, wi: Vec3, u: Tensor, v: Tensor) -> Vec3:
        cosine, phi = self.sample_cosine(table, u), 2.0 * torch.pi * v
        sine = torch.sqrt((1.0 - cosine * cosine).clamp_min(TINY))
        return Frame.of(-wi).to_world(Vec3(sine * torch.cos(phi), sine * torch.sin(phi), cosine))


class PhaseFunction(Phase):
    """Base class of phase functions' plugins: what they give to media."""

    def extreme_areas(self) -> tuple[Tensor | float, Tensor | float]:
        """Bounds of `PhaseKind.projected_area` from above and from below, detached."""
        return 1.0, 1.0

    def even_area(self) -> bool:
        """True if `PhaseKind.projected_area` is the same at all points."""
        return True

    def kind(self) -> PhaseKind:
        """The functions that evaluate and sample the phase function."""
        raise TypeError(f"{type(self).__name__} does not define its kind")

    def row(self) -> Table:
        """The phase function's parameters: a record of () tensors, or of columns, attached."""
        return ()


def entry(column: Tensor, like: Tensor) -> Tensor:
    """The only entry of a column, repeated for every lane."""
    return lookup(column, torch.zeros_like(like, dtype=torch.int32))
