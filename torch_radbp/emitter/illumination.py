"""Records that emitters hand to the tables of a scene: poses of lights without extent, and textures times a factor."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.domain import NUMBER
from torch_radbp.plugin import Emitter, Texture
from torch_radbp.texture.rgb import RGB, as_texture

FACTOR = NUMBER._replace(low=0.0)


def factor(scale: float) -> Tensor:
    """A checked factor of the light that an emitter sends, ().

    Raises:
        ValueError: if it is negative or not finite.
    """
    if not 0 <= scale < math.inf:
        raise ValueError(f"scale must be at least 0 and finite, got {scale}")
    return torch.tensor(float(scale), dtype=torch.get_default_dtype())


class LightPose(NamedTuple):
    """The place of a light without extent, and how it spreads its light; attached."""

    place: Tensor  # (3,) position; of a directional light the unit direction towards it
    to_local: Tensor  # (3, 3) from world directions to those of the light, which shines along its +z
    cone: Tensor  # (2,) of a spot: angle where it ends, and 1 / width of the fall-off before it, radians
    to_uv: Tensor  # (2,) factors from x / z and y / z to texture coordinates, around the middle

    @staticmethod
    def at(place: Tensor, to_local: Tensor | None = None, cone: Tensor | None = None,
           to_uv: Tensor | None = None) -> LightPose:
        """A pose whose other fields have no effect unless they are given."""
        same = torch.eye(3, dtype=place.dtype, device=place.device)
        return LightPose(place, same if to_local is None else to_local,
                         place.new_tensor([math.pi, 1.0]) if cone is None else cone,
                         place.new_zeros(2) if to_uv is None else to_uv)


class Scaled:
    """A texture times a factor, one number or three, with all that a bank of textures reads."""

    def __init__(self, texture: Texture, factor: Tensor):
        self.texture, self.factor = texture, factor
        self.has_coordinates = not isinstance(texture, RGB)
        self.wrap_mode = getattr(texture, "wrap_mode", "repeat")
        self.filter_type = getattr(texture, "filter_type", "nearest")
        self.to_uv = getattr(texture, "to_uv", None)

    def texels(self) -> Tensor:
        """(H, W, 3) linear RGB, attached."""
        return self.texture.texels() * self.factor


def linear_inverse(name: str, matrix: Tensor) -> Tensor:
    """The (3, 3) matrix from world to local directions of an affine (4, 4) pose, attached.

    Raises:
        ValueError: if the pose flattens space.
    """
    linear = matrix[:3, :3]
    if torch.linalg.det(linear.detach().double()) == 0:
        raise ValueError(f"{name} must be invertible, got a matrix with determinant 0")
    return torch.linalg.inv(linear.double()).to(linear.dtype)


def colour(emitter: Emitter, name: str, value: Texture | Tensor | float) -> Texture:
    """A texture of one colour, from any value that the attribute `name` of an emitter accepts.

    Raises:
        ValueError: if it is an image, or negative.
    """
    texture = as_texture(emitter, name, value)
    if not isinstance(texture, RGB):
        raise ValueError(f"{name} of a {emitter.type} emitter must be one number or an rgb, got a {texture.type}")
    return texture
