"""Converts textures of a scene to what glTF has: factors and 8-bit images."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from torch_radbp.formats.image import linear_to_srgb, srgb_to_linear
from torch_radbp.io.gltf.document import Losses
from torch_radbp.io.gltf.written import Written
from torch_radbp.plugin import SceneError, Texture
from torch_radbp.texture.bitmap import Bitmap
from torch_radbp.texture.checkerboard import Checkerboard
from torch_radbp.texture.colour import Colour

WRAPS = {"repeat": 10497, "clamp": 33071, "mirror": 33648}
NEAREST, LINEAR = 9728, 9729
ON_GRID = 1e-5  # error of values that came from 8 bits and go back
SHEAR = 1e-5


class Reading(NamedTuple):
    """The wrap mode, filter and uv transform of an image."""

    wrap: str = "repeat"
    nearest: bool = False
    to_uv: tuple[float, ...] = (1, 0, 0, 0, 1, 0)  # rows of the transform that give u and v


class Slot(NamedTuple):
    """The linear values of a texture, and how they are looked up."""

    values: np.ndarray  # (H, W, 3) float64
    reading: Reading | None  # None: a constant, of 1 x 1 texels

    @property
    def is_constant(self) -> bool:
        return self.reading is None

    @property
    def constant(self) -> np.ndarray:
        """(3,) the mean colour of the texture."""
        return self.values.mean((0, 1))

    def number(self) -> float:
        """The mean of the texture's first channel."""
        return float(self.values[:, :, 0].mean())


def slot(texture: Texture, name: str, losses: Losses, as_number: bool = False) -> Slot:
    """The values of a texture; the mean of one that glTF cannot represent.

    Args:
        texture: of a material.
        name: of it, for messages.
        losses: filled in.
        as_number: read it as Mitsuba reads a number.

    Raises:
        SceneError: if it is a module, or has values that are not finite.
    """
    if isinstance(texture, Colour):
        values = texture.scalars().expand(1, 1, 3) if as_number else texture.texels()
        return Slot(checked_values(values, name), None)
    if isinstance(texture, Bitmap):
        values = texture.scalars()[..., None].expand(-1, -1, 3) if as_number else texture.texels()
        if texture.filter_type == "trilinear":
            losses.add(name, "its filter trilinear is written as linear: glTF leaves to readers how images shrink")
        return Slot(checked_values(values, name),
                    Reading(texture.wrap_mode, texture.filter_type == "nearest", _rows(texture.to_uv)))
    if isinstance(texture, Checkerboard):
        names = texture.numbers if as_number else ("color0", "color1")
        first, second = (slot(getattr(texture, part), f"{name}.{part}", losses, as_number) for part in names)
        if first.is_constant and second.is_constant:
            board = np.stack([first.values, second.values, second.values, first.values]).reshape(2, 2, 3)
            return Slot(board, Reading("repeat", True, _rows(texture.to_uv)))
    if not texture.tabulated:
        raise SceneError(f"{name}: a {type(texture).__name__} cannot be written as glTF; put a bitmap in its place, or save "
                         "its `state_dict()` with torch.save or safetensors")
    losses.add(name, f"a {texture.type} is written as its mean colour")
    parts = [slot(part, name, losses, as_number).constant for part in texture.parts()]
    values = np.mean(parts, axis=0) if parts else checked_values(texture.texels(), name).mean((0, 1))
    return Slot(values.reshape(1, 1, 3), None)


def checked_values(values: Tensor, name: str) -> np.ndarray:
    """Converts values to float64, checked to be finite.

    Raises:
        SceneError: if one is not finite.
    """
    array = values.detach().cpu().numpy().astype(np.float64)
    if not np.isfinite(array).all():
        raise SceneError(f"{name}: not written, it has values that are NaN or infinite")
    return array


def _rows(to_uv: Tensor) -> tuple[float, ...]:
    """The six numbers of the two rows of a uv transform."""
    matrix = to_uv.detach().cpu().double().numpy()
    return tuple(float(matrix[row, column]) for row in (0, 1) for column in (0, 1, 3))


def quantised(values: np.ndarray, srgb: bool) -> tuple[np.ndarray, np.ndarray]:
    """Quantises values to bytes times a factor for each channel: 1 if they fit 8 bits, else the best one.

    Args:
        values: (H, W, 3 or 4) of at least 0; a fourth channel is alpha, which is linear.
        srgb: code the first three as sRGB.

    Returns:
        (H, W, C) bytes, and (C,) factors.
    """
    most = values.max((0, 1))
    whole, part = np.ones_like(most), np.where(most > 0, most, 1.0)
    levels, errors = zip(*(levels_of(values, factor, srgb) for factor in (whole, part)))
    better = errors[1] < errors[0] - ON_GRID
    return np.where(better, levels[1], levels[0]), np.where(better, part, whole)


def levels_of(values: np.ndarray, factor: np.ndarray, srgb: bool) -> tuple[np.ndarray, np.ndarray]:
    """Quantises values to bytes for given factors, and the largest error in each channel, (C,)."""
    shares = torch.from_numpy((values / factor).clip(0.0, 1.0))
    coded = torch.cat([linear_to_srgb(shares[..., :3]), shares[..., 3:]], 2) if srgb else shares
    levels = (coded * 255.0).round()
    back = levels / 255.0
    back = torch.cat([srgb_to_linear(back[..., :3]), back[..., 3:]], 2) if srgb else back
    return levels.to(torch.uint8).numpy(), np.abs(back.numpy() * factor - values).max((0, 1))


def texture_info(out: Written, pixels: np.ndarray, reading: Reading, name: str, losses: Losses) -> dict[str, Any]:
    """Writes an image and returns its texture info."""
    mode = WRAPS[reading.wrap]
    sampler = out.once("samplers", {"wrapS": mode, "wrapT": mode, "magFilter": NEAREST if reading.nearest else LINEAR})
    texture = out.once("textures", {"sampler": sampler, "source": out.image(pixels, name)})
    transform = _uv_transform(reading.to_uv, name, losses)
    extensions = {"extensions": out.extension("KHR_texture_transform", transform)} if transform else {}
    return {"index": texture, **extensions}


def _uv_transform(to_uv: tuple[float, ...], name: str, losses: Losses) -> dict[str, Any]:
    """The entries of KHR_texture_transform; none for the identity. See `texture.uv_transform`."""
    a, b, x, c, d, y = to_uv
    if to_uv == Reading().to_uv:
        return {}
    angle = min(math.atan2(-c, a), math.atan2(b, d), key=abs)  # they differ where one axis is mirrored
    cosine, sine = math.cos(angle), math.sin(angle)
    across, down = a * cosine - c * sine, b * sine + d * cosine
    sheared = abs(b - sine * down) + abs(d - cosine * down)
    if sheared > SHEAR * max(abs(across), abs(down)):
        losses.add(name, "the shear of its to_uv is not written")
    return {"offset": [x, y], "rotation": angle, "scale": [across, down]}


def joined_slots(slots: dict[str, Slot], name: str, losses: Losses) -> tuple[dict[str, np.ndarray], Reading] | None:
    """Merges textures into channels of one image, as arrays of one size; None if all are constant.

    The first that is an image says how it is read. Constants become 1 x 1 arrays. What is read in another way is a loss and
    becomes its mean; what has another size is resampled.
    """
    images = {key: each for key, each in slots.items() if not each.is_constant}
    if not images:
        return None
    reading = next(iter(images.values())).reading
    height, width = (max(each.values.shape[axis] for each in images.values()) for axis in (0, 1))
    arrays = {}
    for key, each in slots.items():
        values = each.values
        if not each.is_constant and each.reading != reading:
            losses.add(name, f"{key} is written as its mean: glTF reads it in the same way as {next(iter(images))}, from "
                             "the same image")
            values = values.mean((0, 1), keepdims=True)
        if key in images and values.shape[:2] not in ((1, 1), (height, width)):
            losses.add(name, f"{key} is resampled from {values.shape[1]} x {values.shape[0]} to {width} x {height} texels")
            mode = "nearest" if reading.nearest else "bilinear"
            planes = torch.from_numpy(values).permute(2, 0, 1)[None]
            values = torch.nn.functional.interpolate(planes, (height, width), mode=mode)[0].permute(1, 2, 0).numpy()
        arrays[key] = values
    return arrays, reading
