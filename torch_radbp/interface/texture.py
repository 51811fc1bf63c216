"""The interface between textures and the path tracer: how lanes evaluate a texture.

Most textures are tables, which the functions of a bounce read. A module is not: its values are computed before the functions
of a bounce run, for the lanes that need them, and are given to these functions.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar, NamedTuple

import torch
from torch import Tensor

from torch_radbp.plugin import Texture
from torch_radbp.tensors.vec import Vec2, Vec3

LUMINANCE = (0.212671, 0.715160, 0.072169)  # weights of linear RGB, ITU-R BT.709 with Mitsuba's digits


@lru_cache(maxsize=16)
def luminance_weights(dtype: torch.dtype, device: torch.device) -> Tensor:
    """(3,) the weights of linear red, green and blue in the luminance, on a device."""
    with torch.inference_mode(False):
        return torch.tensor(LUMINANCE, dtype=dtype, device=device)


class TriangleEdges(NamedTuple):
    """The two edges of the triangle that each lane is on, and the changes of uv and attributes along them; attached."""

    p: tuple[Vec3, Vec3]  # world space
    uv: tuple[Vec2, Vec2] | None  # None if no texture reads surface coordinates
    attributes: dict[str, tuple[Vec3, Vec3]]  # mesh attributes that textures read
    barycentric_gradients: tuple[Vec3, Vec3]  # of the second and the third coordinate, world space


class TexturePoint(NamedTuple):
    """The surface points at which textures are evaluated, (N,) each; attached."""

    uv: Vec2 | None  # surface coordinates; None if no texture reads them
    attributes: dict[str, Vec3]  # mesh attributes that textures read, by name
    edges: TriangleEdges | None = None  # None if no texture needs them
    footprint: Tensor | None = None  # natural logarithm of a footprint's width in `uv`; None if no texture is filtered
    p: Vec3 | None = None  # world space; None if no texture reads it


@dataclass(frozen=True)
class Reader(ABC):
    """Evaluates textures of one kind for lanes; they are stored in one table, their `bank`."""

    needs_uv: ClassVar[bool] = True  # values depend on surface coordinates
    needs_edges: ClassVar[bool] = False  # values depend on how uv or attributes change along the surface
    needs_footprint: ClassVar[bool] = False  # values depend on the footprint of a sample
    needs_position: ClassVar[bool] = False  # values depend on the point in the world
    attributes: ClassVar[tuple[str, ...]] = ()  # mesh attributes that values depend on
    outside: ClassVar[bool] = False  # values are computed outside of compiled code, by an `OutsideReader`

    @abstractmethod
    def bank(self, textures: Sequence[Texture], dtype: torch.dtype, device: torch.device) -> Any:
        """Builds the table (bank) of some textures, attached to their parameters."""

    def of_numbers(self) -> Reader:
        """The reader of the same textures as scalars, if the table does not already hold scalars."""
        return self


def bank_of(reader: Reader, textures: Sequence[Texture], dtype: torch.dtype, device: torch.device) -> Any:
    """Builds the table (bank) of the textures of one reader, attached."""
    return reader.bank(textures, dtype, device)


@dataclass(frozen=True)
class TableReader(Reader):
    """Looks up textures that are stored as tables, within compiled code."""

    @abstractmethod
    def read(self, bank: Any, row: Tensor, point: TexturePoint) -> Vec3:
        """Looks textures up at surface points: linear RGB, attached.

        Args:
            bank: attached or tapped.
            row: (N,) int32, which of the textures each lane reads.
            point: (N,) where; it has what the reader needs.
        """

    @abstractmethod
    def rise(self, bank: Any, row: Tensor, point: TexturePoint) -> Vec2:
        """The change of the first channel along both of `point.edges`, linearised at the point; attached.

        Args: as for `read`.
        """


@dataclass(frozen=True)
class OutsideReader(Reader):
    """Evaluates textures before compiled code runs, on all lanes of a queue at once, as for neural networks."""

    outside: ClassVar[bool] = True

    @abstractmethod
    def place(self, p: Vec3, uv: Vec2 | None) -> Vec2 | Vec3:
        """The input of the texture, from the position and the uv of a surface point."""

    def value(self, given: Vec3, point: TexturePoint) -> Vec3:
        """The value that the material gets: the one computed for the point, or for `SlopeOf` a slope made of it."""
        return given


class Place(NamedTuple):
    """The inputs of textures that are evaluated outside of compiled code, (N,)."""

    row: Tensor  # int32, which texture of its reader; -1: none
    at: Vec2 | Vec3  # input of the texture


class TextureValue(NamedTuple):
    """The values of a texture that was evaluated outside of compiled code, (N,) each."""

    value: Vec3  # attached to the texture's parameters, if derivatives are recorded
    slopes: tuple[Vec3, ...] = ()  # derivatives by each coordinate of the input, detached; empty: the input is detached

    def at(self, place: Vec2 | Vec3) -> Vec3:
        """The value, attached to the texture's input `place` as well, by the slopes."""
        value = self.value
        for slope, coordinate in zip(self.slopes, place):
            value = value + slope * (coordinate - coordinate.detach())
        return value
