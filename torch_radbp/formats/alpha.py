"""Images with their opacity, and their sizes without their pixels."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from torch_radbp.formats.exr import read_exr_with_alpha, read_headers
from torch_radbp.formats.files import check_source, unknown_kind
from torch_radbp.formats.image import LINEAR, READABLE, check_size, open_picture, read_image

ALPHA_MODES = ("RGBA", "LA", "PA")  # of Pillow; it has 16 bits of alpha in RGBA only


def read_alpha(path: str | os.PathLike) -> Tensor | None:
    """The opacity of an image that `read_image` can read: (H, W) float32 in [0, 1], or None if it has none.

    PNG and TGA multiply colours by it when they are shown; in EXR they are multiplied already.

    Raises:
        ValueError, OSError: as `read_image`, which is to be called before.
    """
    kind = READABLE[Path(path).suffix.lower()]
    if kind == "EXR":
        alpha = read_exr_with_alpha(path, check_size)[1]
        return None if alpha is None else torch.from_numpy(np.ascontiguousarray(alpha, dtype=np.float32))
    if kind not in ("PNG", "TGA"):
        return None
    with open_picture(path, kind, os.path.getsize(path)) as file:
        wide = bool(file.tile) and file.tile[0].args == "RGBA;16B"
        if not wide:
            alpha = file.convert("RGBA") if file.mode in ALPHA_MODES or "transparency" in file.info else None
            return None if alpha is None else byte_channel(alpha) / 255.0
        high = byte_channel(file)
    with open_picture(path, kind, os.path.getsize(path)) as file:
        file.tile = [tile._replace(args="RGBA;16L") for tile in file.tile]  # the second byte of each pair
        return (high * 256.0 + byte_channel(file)) / 65535.0


def byte_channel(file: Image.Image) -> Tensor:
    """The bytes of the alpha of an RGBA image, (H, W) float32."""
    return torch.from_numpy(np.array(file.getchannel("A"), dtype=np.float32))


def image_size(path: str | os.PathLike) -> tuple[int, int]:
    """Width and height of an image that `read_image` can read, from its header where the format makes that easy.

    Raises:
        FileNotFoundError: if there is no such file.
        IsADirectoryError: if it is a folder.
        ValueError: on unknown extensions and damaged headers.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in READABLE:
        check_source(path)
        raise ValueError(unknown_kind(path, "image", READABLE))
    kind = READABLE[suffix]
    check_source(path)
    if kind in LINEAR and kind != "EXR":
        height, width = read_image(path).shape[:2]
        return width, height
    try:
        if kind == "EXR":
            low, high = read_headers(path)[0]["dataWindow"]
            width, height = (int(b) - int(a) + 1 for a, b in zip(low, high))
            return width, height
        with open_picture(path, kind, os.path.getsize(path)) as file:
            return file.size
    except (OSError, SyntaxError, ValueError, LookupError) as error:
        raise ValueError(f"{path}: its size cannot be read: {error}") from error
