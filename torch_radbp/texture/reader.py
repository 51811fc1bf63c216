"""The interface between textures and the tracer: how lanes read a value.

Most textures are tables, which the functions of a bounce read. A module is not: its values are computed before the functions
of a bounce run, for the lanes that need them, and are given to these functions.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import torch
from torch import Tensor

from torch_radbp.plugin import Texture
from torch_radbp.tensors.vec import Vec2, Vec3


class TriangleEdges(NamedTuple):
    """The two edges of the triangle that each lane is on, from its first vertex, and what changes along them; attached."""

    p: tuple[Vec3, Vec3]  # world space
    uv: tuple[Vec2, Vec2] | None  # None if no texture reads surface coordinates
    attributes: dict[str, tuple[Vec3, Vec3]]  # those that textures read
    barycentric_gradients: tuple[Vec3, Vec3]  # of the second and the third coordinate, world space


class TexturePoint(NamedTuple):
    """What textures are read at, (N,) each; attached."""

    uv: Vec2 | None  # surface coordinates; None if no texture reads them
    attributes: dict[str, Vec3]  # of the meshes, by name: those that textures read
    edges: TriangleEdges | None = None  # None if no texture needs them
    footprint: Tensor | None = None  # natural logarithm of the width in `uv` of what a sample sees; None if no texture asks


@dataclass(frozen=True)
class Reader(ABC):
    """Reads the textures of one kind, which lie together in a `bank`: a record of tensors, or None."""

    needs_uv: ClassVar[bool] = True  # values depend on surface coordinates
    needs_edges: ClassVar[bool] = False  # they depend on how these change along the surface
    needs_footprint: ClassVar[bool] = False  # they depend on how much of the surface a sample sees
    attributes: ClassVar[tuple[str, ...]] = ()  # of meshes, that values depend on
    outside: ClassVar[bool] = False  # they are computed outside of the functions of a bounce, by an `OutsideReader`

    @abstractmethod
    def bank(self, textures: Sequence[Texture], dtype: torch.dtype, device: torch.device) -> Any:
        """The tables of some textures, attached to their parameters."""

    def of_numbers(self) -> Reader:
        """The reader of the same textures as numbers, where the bank does not make numbers of them."""
        return self


def bank_of(reader: Reader, textures: Sequence[Texture], dtype: torch.dtype, device: torch.device) -> Any:
    """The bank of the textures of one reader, attached."""
    return reader.bank(textures, dtype, device)


@dataclass(frozen=True)
class TableReader(Reader):
    """Reads tables, as a part of the functions of a bounce."""

    @abstractmethod
    def read(self, bank: Any, row: Tensor, point: TexturePoint) -> Vec3:
        """Linear RGB at surface points, attached.

        Args:
            bank: attached or tapped.
            row: (N,) int32, which of the textures each lane reads.
            point: (N,) where; it has what the reader needs.
        """

    @abstractmethod
    def rise(self, bank: Any, row: Tensor, point: TexturePoint) -> Vec2:
        """The change of the first channel along both of `point.edges`, at the rate that it has at the point; attached.

        Args: as for `read`.
        """


@dataclass(frozen=True)
class OutsideReader(Reader):
    """Computes values before the functions of a bounce, on all lanes of a queue at once."""

    outside: ClassVar[bool] = True

    @abstractmethod
    def place(self, p: Vec3, uv: Vec2 | None) -> Vec2 | Vec3:
        """What the values are a function of, from the position and the coordinates of a surface point."""

    def value(self, given: Vec3, point: TexturePoint) -> Vec3:
        """What the material takes, from the value that was computed at the point."""
        return given


class Place(NamedTuple):
    """Where lanes need a value of a texture that is read outside, (N,)."""

    row: Tensor  # int32, of which texture of its reader; -1: of none
    at: Vec2 | Vec3  # what it is a function of


class TextureValue(NamedTuple):
    """The values of a texture that is read outside, (N,) each."""

    value: Vec3  # attached to the texture's parameters, if derivatives are recorded
    slopes: tuple[Vec3, ...] = ()  # its derivative by each coordinate of the place, detached; empty: the place does not move

    def at(self, place: Vec2 | Vec3) -> Vec3:
        """The value, attached to the place as well."""
        value = self.value
        for slope, coordinate in zip(self.slopes, place):
            value = value + slope * (coordinate - coordinate.detach())
        return value
