"""Banks of textures of several kinds, of which each lane reads one."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torch_radbp.interface.texture import TableReader, TexturePoint
from torch_radbp.plugin import Texture
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.vec import Vec2, Vec3, where
from torch_radbp.texture.bitmap import reader_of


class MixedBank(NamedTuple):
    """X textures of several kinds, each a row in its own kind's table."""

    reader: Tensor  # (X,) int32, index of the reader of each
    row: Tensor  # (X,) int32, row in that reader's bank
    banks: tuple[Any, ...]


@dataclass(frozen=True)
class MixedReader(TableReader):
    """Looks textures of several kinds up, for lanes. Bank: `MixedBank`."""

    readers: tuple[TableReader, ...]

    @property
    def needs_uv(self) -> bool:
        return any(reader.needs_uv for reader in self.readers)

    @property
    def needs_footprint(self) -> bool:
        return any(reader.needs_footprint for reader in self.readers)

    @property
    def needs_position(self) -> bool:
        return any(reader.needs_position for reader in self.readers)

    @property
    def attributes(self) -> tuple[str, ...]:
        return tuple(sorted({name for reader in self.readers for name in reader.attributes}))

    def of_numbers(self) -> TableReader:
        return joint_reader(reader.of_numbers() for reader in self.readers)

    def bank(self, textures: Sequence[Texture], dtype: torch.dtype, device: torch.device) -> MixedBank:
        which = [self.readers.index(reader_of(texture)) for texture in textures]
        rows = [which[:number].count(reader) for number, reader in enumerate(which)]
        banks = tuple(reader.bank([texture for texture, read_by in zip(textures, which) if read_by == number], dtype, device)
                      for number, reader in enumerate(self.readers))
        return MixedBank(*(torch.tensor(column, dtype=torch.int32, device=device) for column in (which, rows)), banks)

    def read(self, bank: MixedBank, row: Tensor, point: TexturePoint) -> Vec3:
        which, rows = lookup(bank.reader, row), lookup(bank.row, row)
        value = None
        for number, reader in enumerate(self.readers):
            is_read = which == number
            texels = reader.read(bank.banks[number], torch.where(is_read, rows, 0), point)
            value = texels if value is None else where(is_read, texels, value)
        return value

    def rise(self, bank: MixedBank, row: Tensor, point: TexturePoint) -> Vec2:
        which, rows = lookup(bank.reader, row), lookup(bank.row, row)
        rise = None
        for number, reader in enumerate(self.readers):
            is_read = which == number
            change = reader.rise(bank.banks[number], torch.where(is_read, rows, 0), point)
            rise = change if rise is None else Vec2(*(torch.where(is_read, new, old) for new, old in zip(change, rise)))
        return rise


def reader_for(textures: Sequence[Texture]) -> TableReader:
    """One reader for textures of several kinds; the same for the same kinds in any order."""
    return joint_reader(reader_of(texture) for texture in textures)


def joint_reader(readers: Iterable[TableReader]) -> TableReader:
    """One reader that serves all textures of several readers."""
    readers = sorted(set(readers), key=repr)
    return readers[0] if len(readers) == 1 else MixedReader(tuple(readers))
