"""Checked attributes of emitters: colours, factors, weights, poses."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torch_radbp.interface.texture import Reader
from torch_radbp.plugin import Emitter, Texture
from torch_radbp.plugin.domain import NUMBER
from torch_radbp.texture.bitmap import reader_of
from torch_radbp.texture.colour import Colour
from torch_radbp.texture.rgb import as_texture
from torch_radbp.transforms import matrix_inverse

FACTOR = NUMBER._replace(low=0.0)


def factor(scale: float) -> Tensor:
    """Checks the factor of an emitter's light, and returns it as a () tensor.

    Raises:
        ValueError: if it is negative or not finite.
    """
    return torch.tensor(at_least_zero("scale", scale), dtype=torch.get_default_dtype())


def at_least_zero(name: str, value: float) -> float:
    """`value`, checked to be at least zero and finite."""
    if not 0 <= value < math.inf:
        raise ValueError(f"{name} must be at least 0 and finite, got {value}")
    return float(value)


def weight(sampling_weight: float) -> float:
    """Checks a `sampling_weight`; 0: next-event estimation never selects the emitter, though BSDF sampling may hit it."""
    return at_least_zero("sampling_weight", sampling_weight)


class Scaled:
    """A texture times a constant factor, one number or three."""

    def __init__(self, texture: Texture, factor: Tensor):
        self.texture, self.factor = texture, factor
        self.wrap_mode = getattr(texture, "wrap_mode", "repeat")
        self.filter_type = getattr(texture, "filter_type", "nearest")
        self.to_uv = getattr(texture, "to_uv", None)

    def texels(self) -> Tensor:
        """(H, W, 3) linear RGB, attached."""
        return self.texture.texels() * self.factor

    def reader(self) -> Reader:
        """The reader of the underlying texture."""
        return reader_of(self.texture)

    def colours(self) -> tuple[Scaled, ...]:
        """The colours of a checkerboard times the factor."""
        return tuple(Scaled(colour, self.factor) for colour in self.texture.colours())


def linear_inverse(matrix: Tensor) -> Tensor:
    """The (3, 3) matrix from world to local directions, inverse of an affine (4, 4) pose that is invertible; attached."""
    return matrix_inverse(matrix[:3, :3].double()).to(matrix.dtype)


def colour(emitter: Emitter, name: str, value: Texture | Tensor | float) -> Texture:
    """Makes a texture of one colour from any value that the attribute `name` of an emitter accepts.

    Raises:
        ValueError: if it is an image, or negative.
    """
    texture = as_texture(emitter, name, value)
    if not isinstance(texture, Colour):
        raise ValueError(f"{name} of a {emitter.type} emitter must be one number or an rgb, got a {texture.type}")
    return texture
