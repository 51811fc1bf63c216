"""What a surface is made of, as far as it is fixed when the functions of a bounce are compiled."""

from __future__ import annotations

from typing import NamedTuple

from torch_radbp.bsdf.kind import Kind
from torch_radbp.texture.reader import OutsideReader, Reader


class Appearance(NamedTuple):
    """A kind of BSDF, and how each of the values that it takes is read.

    Lanes queue by it: the functions of a bounce are made for one appearance, and run on the lanes that meet it.
    """

    kind: Kind
    readers: tuple[Reader, ...]

    @property
    def needs_uv(self) -> bool:
        """True if a value depends on the surface coordinates."""
        return any(reader.needs_uv for reader in self.readers)

    @property
    def needs_edges(self) -> bool:
        """True if a value depends on how something changes along the surface."""
        return any(reader.needs_edges for reader in self.readers)

    @property
    def needs_footprint(self) -> bool:
        """True if a value depends on how much of the surface a sample sees."""
        return any(reader.needs_footprint for reader in self.readers)

    @property
    def outside(self) -> tuple[OutsideReader, ...]:
        """The readers of those values that are given to the functions of a bounce."""
        return tuple(reader for reader in self.readers if reader.outside)
