"""Numbers of a material, handed to the tracer as textures whose channels are all the same."""

from __future__ import annotations

from dataclasses import replace

from torch import Tensor

from torch_radbp.plugin import BSDF, Plugin, Texture
from torch_radbp.texture.bitmap import reader_of
from torch_radbp.texture.colour import Colour
from torch_radbp.texture.module_function import ModuleFunction
from torch_radbp.texture.reader import Reader
from torch_radbp.texture.slope import slope_reader


class OwnNumber(Colour):
    """The 0-dim parameter `name` of `owner` as a constant texture.

    The parameter stays registered with its owner, under the owner's name for it; this texture has none of its own.
    """

    def __init__(self, owner: BSDF, name: str):
        Plugin.__init__(self)
        self.place = (owner, name)  # a tuple, so that the owner is no submodule

    def colour(self) -> Tensor:
        """(), attached."""
        owner, name = self.place
        return getattr(owner, name)


class NumberOf(Texture):
    """The texture `name` of `owner` read as a number: the mean or the luminance of the colour at each surface point.

    This is a view: it has the texels, the filter and the coordinates of that texture, and no parameters of its own.
    """

    def __init__(self, owner: Plugin, name: str):
        super().__init__()
        self.place = (owner, name)  # a tuple, so that neither is a submodule

    @property
    def texture(self) -> Texture:
        """The texture that `owner` has now."""
        owner, name = self.place
        return getattr(owner, name)

    def texels(self) -> Tensor:
        """(H, W, 3) the numbers, in all three channels; attached."""
        return self.texture.scalars()[..., None].expand(-1, -1, 3)

    def colours(self) -> tuple[NumberOf, ...]:
        """The numbers of a checkerboard."""
        return tuple(NumberOf(self.texture, name) for name in self.texture.numbers)

    def sources(self) -> tuple[Tensor, ...]:
        """All tensors that the numbers are computed from, attached."""
        return self.texture.sources()

    def reader(self) -> Reader:
        """How lanes read it: as they read that texture."""
        return reader_of(self.texture).of_numbers()

    def function(self) -> ModuleFunction:
        """The numbers as a function of the place, if that texture is no table."""
        return replace(self.texture.function(), as_number=True)

    def __getattr__(self, name: str):
        if name in ("to_uv", "wrap_mode", "filter_type"):
            return getattr(self.texture, name)
        return super().__getattr__(name)


class SlopeOf(NumberOf):
    """The slope of the texture `name` of `owner`, read as a number, along the surface."""

    def reader(self) -> Reader:
        """How lanes read it."""
        return slope_reader(super().reader())

    def function(self) -> ModuleFunction:
        """Its derivative by the place, if that texture is no table."""
        return replace(super().function(), as_slope=True)


class ComputedNumbers(Colour):
    """Three of the numbers that a method of `owner` computes from its parameters, as a constant texture.

    Args:
        owner: the material.
        method: the name of the method, which returns (K,) numbers, attached.
        first: the index of the first of the three.
    """

    def __init__(self, owner: BSDF, method: str, first: int):
        Plugin.__init__(self)
        self.place, self.first = (owner, method), first  # a tuple, so that the owner is no submodule

    def colour(self) -> Tensor:
        """(3,), attached."""
        owner, method = self.place
        return getattr(owner, method)()[self.first:self.first + 3]
