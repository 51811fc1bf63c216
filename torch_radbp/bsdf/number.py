"""A number of a material that is the same everywhere, handed to the tracer as if it were a texture."""

from __future__ import annotations

from torch import Tensor

from torch_radbp.plugin import BSDF, Plugin
from torch_radbp.texture.rgb import RGB


class OwnNumber(RGB):
    """The 0-dim parameter `name` of `owner` as a constant texture.

    The parameter stays registered with its owner, under the owner's name for it; this texture has none of its own.
    """

    def __init__(self, owner: BSDF, name: str):
        Plugin.__init__(self)
        self.place = (owner, name)  # a tuple, so that the owner is no submodule

    @property
    def value(self) -> Tensor:
        """(), attached."""
        owner, name = self.place
        return getattr(owner, name)
