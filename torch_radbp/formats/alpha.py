"""The alpha channel of images, and their sizes without their pixels."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from torch_radbp.formats.exr import read_exr_with_alpha, read_headers
from torch_radbp.formats.files import check_source, unknown_kind
from torch_radbp.formats.image import LINEAR, READABLE, read_image
from torch_radbp.formats.memory import memory_for
from torch_radbp.formats.picture_size import check_size
from torch_radbp.formats.pillow import WITH_ALPHA, open_picture, read_pixels


def read_alpha(path: str | os.PathLike) -> Tensor | None:
    """The opacity of an image that `read_image` can read: (H, W) float32 in [0, 1], or None if it has none.

    Colours are multiplied by it when they are shown; in EXR they are multiplied already.

    Raises:
        ValueError, OSError, MemoryError: as `read_image`, which is to be called before.
    """
    kind = READABLE[Path(path).suffix.lower()]
    with memory_for(path):
        if kind == "EXR":
            alpha = read_exr_with_alpha(path, check_size)[1]
            return None if alpha is None else torch.from_numpy(np.ascontiguousarray(alpha, dtype=np.float32))
        pixels = read_pixels(path, kind) if kind in WITH_ALPHA else np.empty((0, 0, 1), dtype=np.float32)
        return torch.from_numpy(pixels[:, :, -1].copy()) if pixels.shape[2] in (2, 4) else None


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
