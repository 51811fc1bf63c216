"""Scalar parameters of materials, handed to the path tracer as textures with equal channels."""

from __future__ import annotations

from dataclasses import replace

from torch import Tensor

from torch_radbp.interface.texture import Reader
from torch_radbp.plugin import BSDF, Plugin, Texture
from torch_radbp.texture.bitmap import reader_of
from torch_radbp.texture.colour import Colour
from torch_radbp.texture.module_function import ModuleFunction
from torch_radbp.texture.slope import slope_reader


class OwnNumber(Colour):
    """The 0-dim parameter `name` of `owner` as a constant texture.

    The parameter stays registered with its owner, under the owner's name for it; this texture has none of its own.
    """

    def __init__(self, owner: BSDF, name: str):
        Plugin.__init__(self)
        self.place = (owner, name)  # a tuple, so that the owner is no submodule

    def colour(self) -> Tensor:
        """The parameter as a () tensor, attached."""
        owner, name = self.place
        return getattr(owner, name)


class NumberOf(Texture):
    """The texture `name` of `owner` as a scalar texture: the mean or the luminance of the colour at each surface point.

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
        """(H, W, 3) texels with the scalar in all three channels; attached."""
        return self.texture.scalars()[..., None].expand(-1, -1, 3)

    def colours(self) -> tuple[NumberOf, ...]:
        """The two colours of a checkerboard as scalar textures."""
        return tuple(NumberOf(self.texture, name) for name in self.texture.numbers)

    def sources(self) -> tuple[Tensor, ...]:
        """All tensors that the scalars are computed from, attached."""
        return self.texture.sources()

    def reader(self) -> Reader:
        """The reader of the underlying texture, as scalars."""
        return reader_of(self.texture).of_numbers()

    def function(self) -> ModuleFunction:
        """The scalar as a function of the surface point, for textures with computed values."""
        return replace(self.texture.function(), as_number=True)

    def __getattr__(self, name: str):
        if name in ("to_uv", "wrap_mode", "filter_type", "volume"):
            return getattr(self.texture, name)
        return super().__getattr__(name)


class SlopeOf(NumberOf):
    """The slope along the surface of the texture `name` of `owner`, read as a scalar."""

    def reader(self) -> Reader:
        """The reader that evaluates slopes along the surface."""
        return slope_reader(super().reader())

    def function(self) -> ModuleFunction:
        """The derivative of the scalar along the surface, for textures with computed values."""
        return replace(super().function(), as_slope=True)


class ComputedNumbers(Colour):
    """Three of the scalars that a method of `owner` computes from its parameters, as a constant texture.

    Args:
        owner: the material.
        method: the name of the method, which returns (K,) numbers, attached.
        first: the index of the first of the three.
    """

    def __init__(self, owner: BSDF, method: str, first: int):
        Plugin.__init__(self)
        self.place, self.first = (owner, method), first  # a tuple, so that the owner is no submodule

    def colour(self) -> Tensor:
        """The three scalars, (3,), attached."""
        owner, method = self.place
        return getattr(owner, method)()[self.first:self.first + 3]
