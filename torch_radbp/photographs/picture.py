"""One photograph: its image and mask, as files or tensors, and their linear values."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.formats.alpha import image_size, read_alpha
from torch_radbp.formats.image import LINEAR, READABLE, read_image, srgb_to_linear
from torch_radbp.plugin import nearest

CURVES = {"srgb": srgb_to_linear, "linear": lambda values: values}
ASSOCIATED = ("EXR",)  # their colours are multiplied by alpha already

MASK_ROUNDING = 1e-3  # of masks in half precision, which a filter has smoothed

Source = Path | Tensor


class Picture(NamedTuple):
    """The image and mask of a photograph, as files or tensors."""

    image: Source
    mask: Source | None


def as_source(name: str, value: str | os.PathLike | Tensor, channels: int) -> Source:
    """Checks a path, or a tensor (channels, H, W), which is copied to the CPU; boolean masks become 0 and 1.

    Raises:
        TypeError: if it is neither.
        ValueError: if the tensor has another shape, or a mask values outside of [0, 1], such as bytes.
    """
    if isinstance(value, (str, os.PathLike)):
        return Path(value)
    if isinstance(value, Tensor) and value.dtype == torch.bool and channels == 1:
        value = value.float()
    if not isinstance(value, Tensor) or not value.is_floating_point():
        got = value.dtype if isinstance(value, Tensor) else type(value).__name__
        raise TypeError(f"{name} must be a path or a tensor of floating point numbers, got {got}")
    if value.ndim != 3 or value.shape[0] != channels or value.numel() == 0:
        raise ValueError(f"{name} must have shape ({channels}, H, W), got {tuple(value.shape)}")
    value = value.detach().cpu()
    if channels == 1 and not 0 <= value.min() <= value.max() <= 1:
        raise ValueError(f"{name} must be in [0, 1], got {value.min():.4g} to {value.max():.4g}")
    return value


def picture_size(source: Source) -> tuple[int, int]:
    """Width and height of an image; of a file from its header."""
    return image_size(source) if isinstance(source, Path) else (source.shape[2], source.shape[1])


def checked_curve(curve: str | float) -> str | float:
    """Checks the name of a curve, or a gamma, and returns it.

    Raises:
        ValueError: otherwise.
    """
    if isinstance(curve, str) and curve in CURVES:
        return curve
    if isinstance(curve, (int, float)) and not isinstance(curve, bool) and 0 < curve < float("inf"):
        return float(curve)
    raise ValueError(f"curve must be a gamma greater than 0, such as 2.2, or the name of a curve, got {curve!r:.60}; "
                     f"{nearest(str(curve)[:60], CURVES)}")


def _decoded(path: Path, curve: str | float) -> Tensor:
    """(3, H, W) linear values of a file, ignoring its alpha."""
    values = read_image(path, raw=True)
    if READABLE[path.suffix.lower()] not in LINEAR:
        values = CURVES[curve](values) if isinstance(curve, str) else values**curve
    return values.expand(-1, -1, 3).movedim(-1, 0)


def read_picture(picture: Picture, curve: str | float, background: Tensor) -> tuple[Tensor, Tensor]:
    """Reads the image, (3, H, W), and the mask, (1, H, W), of a photograph, float32; as `Photographs` describes them.

    Args:
        picture: where they are.
        curve: of files that are not linear.
        background: (3,) linear, behind what alpha lets through.

    Raises:
        ValueError: names a file whose values are not finite where they count, or a mask that is not in [0, 1] or has another
            size than its image.
    """
    if isinstance(picture.image, Tensor):
        image, alpha = picture.image.float(), None
    else:
        image, alpha = _decoded(picture.image, curve), read_alpha(picture.image)
    if alpha is not None:
        over = image if READABLE[picture.image.suffix.lower()] in ASSOCIATED else image * alpha
        image = over + (1 - alpha) * background[:, None, None]
    if alpha is not None and not alpha.isfinite().all():
        raise ValueError(f"{picture_name(picture.image)}: its alpha has values that are NaN or infinite; mend it first")
    mask = torch.ones_like(image[:1]) if alpha is None else alpha[None].clamp(0, 1)
    if picture.mask is not None:
        given = read_mask(picture.mask)
        if given.shape[1:] != image.shape[1:]:
            raise ValueError(f"the mask {picture_name(picture.mask)} has {given.shape[2]} x {given.shape[1]} pixels, and "
                             f"its image {image.shape[2]} x {image.shape[1]}")
        mask = mask * in_range(picture_name(picture.mask), given)
    finite = image.isfinite()
    image, bad = image.where(finite | (mask > 0), 0.0), int((~finite & (mask > 0)).sum())
    if bad:
        raise ValueError(f"{picture_name(picture.image)}: {bad} values of the image are NaN or infinite; mend it first, or "
                         f"give a mask that is 0 there")
    return image.contiguous(), mask.contiguous()


def in_range(name: str, mask: Tensor) -> Tensor:
    """Clamps a mask to [0, 1] if it is outside by rounding only.

    Raises:
        ValueError: if it is outside by more, or has NaN.
    """
    if not ((mask >= -MASK_ROUNDING) & (mask <= 1 + MASK_ROUNDING)).all():
        raise ValueError(f"{name} must be in [0, 1], how much of a pixel counts, got {mask.min():.4g} to {mask.max():.4g}")
    return mask.clamp(0, 1)


def read_mask(source: Source) -> Tensor:
    """Reads a mask, (1, H, W) float32; of a file the mean of its channels, without any curve."""
    if isinstance(source, Tensor):
        return source.float()
    return read_image(source, raw=True).mean(-1)[None]


def picture_name(source: Source) -> str:
    """The name of an image in error messages."""
    return str(source) if isinstance(source, Path) else f"a tensor of shape {tuple(source.shape)}"


def background_colour(value: float | Sequence[float] | Tensor) -> Tensor:
    """Converts one number or three to a (3,) float32 colour.

    Raises:
        ValueError: if it is something else.
    """
    try:
        colour = torch.as_tensor(value, dtype=torch.float32).detach().cpu()
    except (TypeError, ValueError, RuntimeError):
        colour = torch.empty(0)
    if colour.shape not in ((), (3,)) or not bool(colour.isfinite().all()):
        raise ValueError(f"background must be a number or three, linear, got {value!r:.60}")
    return colour.expand(3)
