"""A texture from an image."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import torch
from torch import Tensor

from torch_radbp.formats.image import read_image, srgb_to_linear
from torch_radbp.interface.texture import Reader, TableReader, TexturePoint, TriangleEdges, luminance_weights
from torch_radbp.plugin import Filename, Matrix4, Plugin, Texture, finite, nearest, register
from torch_radbp.plugin.domain import Domain
from torch_radbp.plugin.jump_lines import JumpLines
from torch_radbp.tensors.interleaved import columns_of_rows
from torch_radbp.tensors.vec import Vec2, Vec3
from torch_radbp.texture.bank import TextureBank, sample_texture, texture_slope
from torch_radbp.texture.pyramid import PyramidBank, pyramid, pyramid_slope, sample_pyramid, starts
from torch_radbp.texture.uv_transform import jump_lines, uv_matrix, uv_rows

WRAP_MODES = ("repeat", "mirror", "clamp")
FILTERS = ("bilinear", "nearest", "trilinear")
FORMATS = ("auto", "variant", "float16", "fp16", "uint8")
IMAGES = {channels: Domain(shapes=(("H", "W", channels),)) for channels in (1, 3)}
TO_UV = Domain(shapes=((4, 4),))


def linear_image(kind: str, filename: str | None, arrays: dict[str, Tensor | None], raw: bool = False) -> Tensor:
    """(H, W, 3) linear RGB or (H, W, 1) linear grey, from a file or from an array.

    Args:
        kind: "a bitmap", for messages.
        filename: of a kind that `read_image` reads, or None.
        arrays: by the names of attributes that mean the same; (H, W), (H, W, 1) or (H, W, 3), at most one not None. Of bytes
            they are coded as the pixels of an 8-bit file.
        raw: see `Bitmap`.

    Raises:
        ValueError: unless exactly one is given; on wrong shapes, and values that are not finite.
    """
    given = {name: array for name, array in arrays.items() if array is not None}
    if len(given) + (filename is not None) != 1:
        name, other = arrays
        raise ValueError(f"{kind} needs either filename or {name}, and not both; {other} is another name for {name}")
    if not given:
        given = {"filename": read_image(filename, raw=raw)}
    (name, data), = given.items()
    data = _decoded(data, raw) if data.dtype == torch.uint8 else finite(name, data).to(torch.get_default_dtype())
    data = data[..., None] if data.ndim == 2 else data
    if data.ndim != 3 or data.shape[2] not in (1, 3) or data.numel() == 0:
        raise ValueError(f"{name} must have shape (H, W), (H, W, 1) or (H, W, 3), got {tuple(data.shape)}")
    return data


def _decoded(data: Tensor, raw: bool) -> Tensor:
    """Converts bytes to linear values, by sRGB's curve unless they are `raw`, as Mitsuba does."""
    fractions = data.to(torch.get_default_dtype()) / 255.0
    return fractions if raw else srgb_to_linear(fractions)


@dataclass(frozen=True)
class BitmapReader(TableReader):
    """Looks images up, for lanes. Bank (table of textures): `TextureBank`."""

    def bank(self, textures: Sequence[Texture], dtype: torch.dtype, device: torch.device) -> TextureBank:
        return texture_bank(textures, dtype, device)

    def read(self, bank: TextureBank, row: Tensor, point: TexturePoint) -> Vec3:
        return sample_texture(bank, row, point.uv)

    def rise(self, bank: TextureBank, row: Tensor, point: TexturePoint) -> Vec2:
        return _along(texture_slope(bank, row, point.uv), point.edges)


@dataclass(frozen=True)
class PyramidReader(BitmapReader):
    """Looks images up at the mipmap level that fits the sample's footprint. Bank: `PyramidBank`."""

    needs_footprint: ClassVar[bool] = True

    def bank(self, textures: Sequence[Texture], dtype: torch.dtype, device: torch.device) -> PyramidBank:
        return pyramid_bank(textures, dtype, device)

    def read(self, bank: PyramidBank, row: Tensor, point: TexturePoint) -> Vec3:
        return sample_pyramid(bank, row, point.uv, point.footprint)

    def rise(self, bank: PyramidBank, row: Tensor, point: TexturePoint) -> Vec2:
        return _along(pyramid_slope(bank, row, point.uv, point.footprint), point.edges)


def _along(slope: Vec2, edges: TriangleEdges) -> Vec2:
    """The change of a texture along two edges of a triangle, from its derivatives by u and by v."""
    return Vec2(*(slope.x * edge.x + slope.y * edge.y for edge in edges.uv))


class Level(NamedTuple):
    """One mipmap level of an image, with the attributes that `texture_bank` reads."""

    image: Tensor  # (H, W, 3)
    to_uv: Tensor
    wrap_mode: str
    filter_type: str = "bilinear"

    def texels(self) -> Tensor:
        """The texels of this mipmap level, (H, W, 3) linear RGB, attached."""
        return self.image


def pyramid_bank(textures: Sequence[Texture], dtype: torch.dtype, device: torch.device) -> PyramidBank:
    """Builds the mipmaps of images, attached."""
    levels = [[Level(image, texture.to_uv, texture.wrap_mode) for image in
               pyramid(texture.texels().to(dtype=dtype, device=device))] for texture in textures]
    counts = [len(image) for image in levels]
    first, count = (torch.tensor(column, dtype=torch.int32, device=device) for column in (starts(counts), counts))
    return PyramidBank(texture_bank([level for image in levels for level in image], dtype, device), first, count)


def texture_bank(textures: Sequence[Texture], dtype: torch.dtype, device: torch.device) -> TextureBank:
    """Builds the table of images, attached; a texture that is no image has one texel."""
    images = [texture.texels().to(dtype=dtype, device=device) for texture in textures]
    to_u, to_v = uv_rows([getattr(texture, "to_uv", None) for texture in textures], dtype, device)
    offset, width, height, wrap, nearest = columns_of_images(
        tuple(tuple(image.shape[:2]) for image in images),
        tuple(getattr(texture, "wrap_mode", "repeat") for texture in textures),
        tuple(getattr(texture, "filter_type", "nearest") == "nearest" for texture in textures), device)
    rows = [image.reshape(-1, 3) for image in images]
    return TextureBank(Vec3(*columns_of_rows(rows[0] if len(rows) == 1 else torch.cat(rows))), offset, width, height, wrap,
                       nearest, to_u, to_v)


@functools.lru_cache(maxsize=64)
def columns_of_images(sizes: tuple[tuple[int, int], ...], wrap_modes: tuple[str, ...], nearest: tuple[bool, ...],
                      device: torch.device) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """The columns of `TextureBank` from `offset` to `nearest`.

    Args:
        sizes: height and width of each.
        wrap_modes, nearest: of each.
        device: of the result.
    """
    offsets = [0, *itertools.accumulate(height * width for height, width in sizes)][:-1]
    with torch.inference_mode(False):  # they are kept, for renderings that are differentiated
        integers = (torch.tensor(values, dtype=torch.int32, device=device) for values in (
            offsets, [width for _, width in sizes], [height for height, _ in sizes],
            [WRAP_MODES.index(mode) for mode in wrap_modes]))
        return *integers, torch.tensor(nearest, device=device)


def reader_of(texture: Texture) -> Reader:
    """The object that looks a texture up for lanes; a texture without one is treated as an image."""
    return texture.reader() if hasattr(texture, "reader") else BitmapReader()


@register("texture", "bitmap")
class Bitmap(Texture):
    """An image; row 0 lies at v = 0, as in Mitsuba.

    Parameters: `data`, (H, W, 3) linear RGB or (H, W, 1) grey, as the file or the array has channels; `to_uv`, (4, 4),
    unless the filter is nearest. Derivatives: with respect to both.

    Args:
        filename: EXR, HDR, PFM, PNG, JPEG, BMP, TGA, WebP or TIFF. Either this or `data`.
        data, bitmap: (H, W), (H, W, 1) or (H, W, 3) linear values, or bytes (uint8) as in an 8-bit file; both names mean the
            same.
        filter_type: bilinear; nearest, where `to_uv` moves nothing but edges of texels and is no parameter; or trilinear,
            which Mitsuba does not have: of materials, means over about what a pixel sees of the surface are read from a
            pyramid of coarser images (`torch_radbp.texture.pyramid`, `torch_radbp.vertex.cone`), which is quiet and, where a
            texture is smaller than pixels, blurred. Emitters are read bilinear. Derivatives include that of the level.
        wrap_mode: repeat, mirror or clamp.
        raw: do not decode sRGB when reading an 8- or 16-bit file, or bytes.
        to_uv: transform of the surface coordinates before the lookup (its 2D affine part).
        format: auto, variant, float16 (also fp16) or uint8: how Mitsuba stores the image. Here it has the scene's dtype.
        accel: whether Mitsuba reads it by the texture units of a GPU. Of no effect here.

    Raises:
        ValueError: on unknown modes, a wrong shape, or values that are not finite.
    """

    entries = "data"

    def __init__(self, *, filename: Filename | None = None, data: Tensor | None = None, bitmap: Tensor | None = None,
                 filter_type: str = "bilinear", wrap_mode: str = "repeat", raw: bool = False, to_uv: Matrix4 | None = None,
                 format: str = "auto", accel: bool = True):
        super().__init__()
        for name, value, supported in (("filter_type", filter_type, FILTERS), ("wrap_mode", wrap_mode, WRAP_MODES),
                                       ("format", format, FORMATS)):
            if value not in supported:
                raise ValueError(f"{name} {value!r} is not known; {nearest(value, supported)}")
        self.filename, self.filter_type, self.wrap_mode, self.raw = filename, filter_type, wrap_mode, raw
        self.format, self.accel = format, accel
        image = linear_image("a bitmap", filename, {"data": data, "bitmap": bitmap}, raw)
        self.channels = image.shape[2]
        self.freeze("data", image)
        if filter_type == "nearest":
            self.register_buffer("to_uv", uv_matrix(to_uv))
        else:
            self.freeze("to_uv", uv_matrix(to_uv))

    bitmap = None  # resolved into `data`

    def domains(self) -> dict[str, Domain]:
        return {"data": IMAGES[self.channels], "to_uv": TO_UV}

    def reader(self) -> BitmapReader:
        """The object that looks images up for lanes: with mipmaps or without."""
        return PyramidReader() if self.filter_type == "trilinear" else BitmapReader()

    def jumps(self) -> tuple[JumpLines, ...]:
        height, width = self.resolution()
        return jump_lines(self.to_uv, (width, height), self.wrap_mode == "clamp") if self.filter_type == "nearest" else ()

    def for_mitsuba(self) -> Plugin:
        if self.filter_type == "trilinear":
            raise ValueError("its bitmaps have no filter_type 'trilinear'")
        return self

    def texels(self) -> Tensor:
        """The texels as (H, W, 3) linear RGB, attached."""
        return self.data.expand(-1, -1, 3)

    def scalars(self) -> Tensor:
        """The texels as scalars, (H, W): the luminance, as in Mitsuba; attached."""
        data = self.data
        return data[..., 0] if self.channels == 1 else (data * luminance_weights(data.dtype, data.device)).sum(2)
