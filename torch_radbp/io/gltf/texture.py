"""Reads the textures of a glTF document as bitmaps."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from torch_radbp.formats.image import srgb_to_linear
from torch_radbp.io.gltf.document import Document, DocumentPart, Losses
from torch_radbp.io.gltf.picture import Pictures
from torch_radbp.texture.bitmap import Bitmap

WRAPS = {10497: "repeat", 33071: "clamp", 33648: "mirror"}
NEAREST = 9728
# Other filters for magnification are the same here, and those for minification say how to approximate what is sampled.


class Image(NamedTuple):
    """The texels of a glTF texture, and how they are looked up."""

    texels: np.ndarray  # (H, W, 4) bytes as they are coded
    filter_type: str
    wrap_mode: str
    to_uv: Tensor | None  # (4, 4)

    def bitmap(self, data: Tensor, filter_type: str | None = None) -> Bitmap:
        """A bitmap of (H, W, C) linear values, with the filter, wrapping and texture coordinates of this glTF texture."""
        return Bitmap(data=data.to(torch.get_default_dtype()), filter_type=filter_type or self.filter_type,
                      wrap_mode=self.wrap_mode, to_uv=self.to_uv)

    def colour(self) -> Tensor:
        """(H, W, 3) linear values, float64, of texels in sRGB."""
        return srgb_to_linear(torch.from_numpy(self.texels[:, :, :3] / 255.0))

    def channel(self, number: int) -> Tensor:
        """(H, W, 1) one channel, float64, of linear texels; 3 is alpha, which always is linear."""
        return torch.from_numpy(self.texels[:, :, number:number + 1] / 255.0)


class GltfTextures:
    """Reads texture infos as bitmaps; all textures of one material must read the same uv set."""

    def __init__(self, document: Document, pictures: Pictures, losses: Losses):
        self.document, self.pictures, self.losses = document, pictures, losses

    def image(self, material: DocumentPart, owner: DocumentPart, name: str, sets: list[int]) -> Image | None:
        """Reads the texture info `name` of `owner`; None if there is none, or it cannot be read.

        Args:
            material: for messages.
            owner: the material, or a part of it.
            name: such as baseColorTexture.
            sets: the sets of coordinates that the material reads so far; filled in.
        """
        if not owner.has(name):
            return None
        info = owner.part(name)
        texture = self.document.referred("textures", info, "index")
        transform = info.extension("KHR_texture_transform")
        chosen = info.integer("texCoord", 0)
        if transform is not None:
            chosen = transform.integer("texCoord", chosen)
        if sets and chosen not in sets:
            self.losses.add(material.place, f"{name} is not read: it uses TEXCOORD_{chosen}, other textures "
                                            f"TEXCOORD_{sets[0]}, and a mesh has one set of coordinates here")
            return None
        if not texture.has("source"):
            self.losses.add(texture.place, "is not read: it has no PNG or JPEG image")
            return None
        sets.append(chosen)
        sampler = self.document.referred("samplers", texture, "sampler", None) or DocumentPart(texture.file, "sampler", {})
        wraps = [sampler.choice(direction, WRAPS, 10497) for direction in ("wrapS", "wrapT")]
        if wraps[0] != wraps[1]:
            self.losses.add(sampler.place, f"wrapS {wraps[0]!r} is used for wrapT, which is {wraps[1]!r}, too")
        return Image(self.pictures.pixels(texture.integer("source"), texture),
                     "nearest" if sampler.integer("magFilter", 9729) == NEAREST else "bilinear", wraps[0],
                     None if transform is None else uv_transform(transform))


def uv_transform(transform: DocumentPart) -> Tensor:
    """(4, 4) matrix of a KHR_texture_transform: scale, then rotation, then offset.

    The rotation is counter-clockwise where v points down, as the text of the extension, its example, Blender and Babylon.js
    have it, and not as its GLSL has it (glTF issue 1563).
    """
    (x, y), (across, down) = transform.numbers("offset", 2, [0, 0]), transform.numbers("scale", 2, [1, 1])
    angle = transform.number("rotation", 0.0)
    c, s = math.cos(angle), math.sin(angle)
    matrix = torch.eye(4, dtype=torch.float64)
    matrix[0, 0], matrix[0, 1], matrix[0, 3] = c * across, s * down, x
    matrix[1, 0], matrix[1, 1], matrix[1, 3] = -s * across, c * down, y
    return matrix
