"""The interface between media and the tracer.

A medium fills the whole scene. It has two parts, as an emitter has: its `MediumKind`, a hashable value that names the
functions, and a table of its numbers, attached to its parameters. What a vertex sends along a ray, and the light that
reaches it along a connection, counts by the share that the medium lets through:

    L = T(ray) (E + F L'),    E = Le + visible T(connection) Ld

Media that scatter are events of their own, and not yet there.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

from torch import Tensor

from torch_radbp.plugin import Plugin
from torch_radbp.tensors.vec import Ray, Vec3

Table = Any  # a NamedTuple of columns of one row


@dataclass(frozen=True)
class MediumKind(ABC):
    """The functions of one kind of medium."""

    @abstractmethod
    def transmittance(self, table: Table, ray: Ray, distance: Tensor) -> Vec3:
        """The share of light that is left after a distance along each ray, (N,), in [0, 1].

        Args:
            table: of the medium, read by `lookup` at row 0; attached, as the result is.
            ray: (N,) world, unit directions; attached where rays carry derivatives, as `distance` is.
            distance: (N,) to the next surface; 1e10 where there is none.
        """


class Medium(Plugin):
    """What a medium's plugin gives to the tracer."""

    category = "medium"

    def kind(self) -> MediumKind:
        """The functions."""
        raise TypeError(f"{type(self).__name__} does not define its kind")

    def row(self) -> Table:
        """The table: a record of () tensors, attached."""
        raise TypeError(f"{type(self).__name__} does not define its row")
