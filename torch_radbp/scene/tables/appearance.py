"""The appearance of a surface: its kind of BSDF and kinds of textures, for which the functions of a bounce are compiled."""

from __future__ import annotations

from typing import NamedTuple

from torch_radbp.interface.bsdf import Kind
from torch_radbp.interface.texture import OutsideReader, Reader


class Appearance(NamedTuple):
    """The kind of BSDF of a surface, and how each of its parameters is read from textures.

    Lanes are queued by it: functions of a bounce are compiled for one appearance, and run on the lanes that hit it.
    """

    kind: Kind
    readers: tuple[Reader, ...]

    @property
    def needs_uv(self) -> bool:
        """True if a parameter depends on the surface coordinates u and v."""
        return any(reader.needs_uv for reader in self.readers)

    @property
    def needs_edges(self) -> bool:
        """True if a parameter depends on how a texture changes along the surface, as bump maps do."""
        return any(reader.needs_edges for reader in self.readers)

    @property
    def needs_footprint(self) -> bool:
        """True if a parameter depends on the footprint of a sample, as filtered textures do."""
        return any(reader.needs_footprint for reader in self.readers)

    @property
    def outside(self) -> tuple[OutsideReader, ...]:
        """The readers of textures that are evaluated outside of compiled code, such as neural networks."""
        return tuple(reader for reader in self.readers if reader.outside)
