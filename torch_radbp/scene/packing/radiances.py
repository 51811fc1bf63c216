"""The textures of a scene's emitters: which are rows of one table (bank), and which are evaluated outside of it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import torch

from torch_radbp.interface.emitter import Light
from torch_radbp.interface.texture import OutsideReader, TableReader, bank_of
from torch_radbp.plugin import Texture
from torch_radbp.scene.cache.pack_cache import PackCache
from torch_radbp.texture.bitmap import BitmapReader, reader_of
from torch_radbp.texture.colour import ColourReader
from torch_radbp.texture.mixed import MixedReader, reader_for
from torch_radbp.texture.rgb import RGB


class BankBuilder:
    """Collects textures for one table, in which each distinct texture is stored once."""

    def __init__(self) -> None:
        self.textures: list[Texture] = []
        self.index: dict[int, int] = {}

    def add(self, texture: Texture) -> int:
        """The row of a texture in the table; new textures are added."""
        if id(texture) not in self.index:
            self.index[id(texture)] = len(self.textures)
            self.textures.append(texture)
        return self.index[id(texture)]

    @property
    def reader(self) -> TableReader:
        """The reader for all textures of the table; if there are bitmaps, constant colours become images of one texel."""
        reader = reader_for(self.textures or [RGB(value=0.0)])
        kinds = reader.readers if isinstance(reader, MixedReader) else (reader,)
        return BitmapReader() if all(isinstance(kind, (BitmapReader, ColourReader)) for kind in kinds) else reader

    @property
    def has_bitmaps(self) -> bool:
        return any(reader_of(texture).needs_uv for texture in self.textures)


class Radiances(NamedTuple):
    """For each emitter, the table and row in which its texture is stored."""

    reader: TableReader  # of the bank
    has_bitmaps: bool  # some textures of the bank have coordinates
    banked: tuple[Light, ...]  # for each texture of the bank one emitter that uses it
    row: dict[int, int]  # row in the bank by id of the emitter; 0 for emitters without a texture there
    lit: tuple[OutsideReader, ...]  # see `Layout`
    lit_banked: tuple[tuple[Light, ...], ...]  # as `banked`, for the bank of each
    lit_rows: dict[int, tuple[int, ...]]  # `Emission.outside` by id of the emitter

    def lit_banks(self, dtype: torch.dtype, device: torch.device) -> tuple[Any, ...]:
        """The tables of emitters' network textures, which are evaluated outside of compiled code."""
        return tuple(reader.bank([emitter.radiated() for emitter in emitters], dtype, device)
                     for reader, emitters in zip(self.lit, self.lit_banked))


def radiances_of(cache: PackCache, emitters: tuple[Light, ...]) -> Radiances:
    """Assigns the textures of emitters to tables; `cache` is not used."""
    radiated = [(emitter, texture) for emitter in emitters if (texture := emitter.radiated()) is not None]
    outside = [(emitter, texture) for emitter, texture in radiated if reader_of(texture).outside]
    inside = [(emitter, texture) for emitter, texture in radiated if not reader_of(texture).outside]
    builder = BankBuilder()
    row = {id(emitter): 0 for emitter in emitters} | {id(emitter): builder.add(texture) for emitter, texture in inside}
    readers = tuple(dict.fromkeys(reader_of(texture) for _, texture in outside))
    by_reader = [[(emitter, texture) for emitter, texture in outside if reader_of(texture) == reader] for reader in readers]
    rows = [_numbered(each) for each in by_reader]
    return Radiances(builder.reader, builder.has_bitmaps, firsts(inside), row, readers, tuple(map(firsts, by_reader)),
                     {id(emitter): tuple(numbers.get(id(emitter), -1) for numbers in rows) for emitter in emitters})


def _numbered(pairs: Sequence[tuple[Light, Texture]]) -> dict[int, int]:
    """The index of each emitter's texture among the distinct ones, by the id of the emitter."""
    builder = BankBuilder()
    return {id(emitter): builder.add(texture) for emitter, texture in pairs}


def firsts(pairs: Sequence[tuple[Light, Texture]]) -> tuple[Light, ...]:
    """The emitters whose textures are distinct: for each texture the first emitter that has it, in order."""
    first: dict[int, Light] = {}
    for emitter, texture in pairs:
        first.setdefault(id(texture), emitter)
    return tuple(first.values())


def bank_of_radiances(cache: PackCache, radiances: Radiances, dtype: torch.dtype, device: torch.device) -> Any:
    """Builds the table of the emitters' textures, attached."""
    textures = [emitter.radiated() for emitter in radiances.banked] or [RGB(value=0.0)]
    twins = tuple(cache.twin(number, texture) for number, texture in enumerate(textures))
    return cache(bank_of, radiances.reader, twins, dtype, device)
