"""The slope of a texture along the surface, by which bump maps turn normals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor

from torch_radbp.interface.texture import OutsideReader, Reader, TableReader, TexturePoint, TriangleEdges
from torch_radbp.plugin import Texture
from torch_radbp.tensors.vec import Vec2, Vec3, dot
from torch_radbp.texture.module_bank import ModuleBank
from torch_radbp.texture.neural import ModuleReader


def along_surface(rise: Vec2, edges: TriangleEdges) -> Vec3:
    """The slope along the surface, from the rises along a triangle's edges; components as in `barycentric_gradients.py`."""
    of_second, of_third = edges.barycentric_gradients
    return of_second * rise.x + of_third * rise.y


@dataclass(frozen=True)
class SlopeReader(TableReader):
    """Evaluates slopes along the surface of the textures that `reader` looks up. Bank: that of `reader`."""

    reader: TableReader
    needs_edges: ClassVar[bool] = True

    @property
    def needs_uv(self) -> bool:
        return self.reader.needs_uv

    @property
    def needs_footprint(self) -> bool:
        return self.reader.needs_footprint

    @property
    def needs_position(self) -> bool:
        return self.reader.needs_position

    @property
    def attributes(self) -> tuple[str, ...]:
        return self.reader.attributes

    def bank(self, textures: Sequence[Texture], dtype: torch.dtype, device: torch.device) -> Any:
        return self.reader.bank(textures, dtype, device)

    def read(self, bank: Any, row: Tensor, point: TexturePoint) -> Vec3:
        return along_surface(self.reader.rise(bank, row, point), point.edges)

    def rise(self, bank: Any, row: Tensor, point: TexturePoint) -> Vec2:
        raise TypeError("slopes have no slopes")


@dataclass(frozen=True)
class ModuleSlopeReader(OutsideReader):
    """Evaluates slopes of modules along the surface. Bank: `ModuleBank`."""

    reader: ModuleReader
    needs_edges: ClassVar[bool] = True

    @property
    def of(self) -> str:
        return self.reader.of

    @property
    def needs_uv(self) -> bool:
        return self.reader.needs_uv

    def bank(self, textures: Sequence[Texture], dtype: torch.dtype, device: torch.device) -> ModuleBank:
        return self.reader.bank(textures, dtype, device)

    def place(self, p: Vec3, uv: Vec2 | None) -> Vec2 | Vec3:
        return self.reader.place(p, uv)

    def value(self, given: Vec3, point: TexturePoint) -> Vec3:
        edges = point.edges
        if self.reader.of == "position":
            return along_surface(Vec2(*(dot(given, edge) for edge in edges.p)), edges)
        return along_surface(Vec2(*(given.x * edge.x + given.y * edge.y for edge in edges.uv)), edges)


def slope_reader(reader: Reader) -> Reader:
    """The reader of slopes along the surface, for textures of another reader."""
    return ModuleSlopeReader(reader) if reader.outside else SlopeReader(reader)
