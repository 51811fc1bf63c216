"""Reads PNG, JPEG, BMP, TGA, WebP and TIFF through Pillow, with all bits and alpha."""

from __future__ import annotations

import io
import os
import struct
import sys
import warnings
import zlib
from pathlib import Path
from typing import BinaryIO

import numpy as np
from PIL import Image
from PIL.TiffImagePlugin import TiffImageFile

from torch_radbp.formats.files import opened
from torch_radbp.formats.picture_size import MAX_PIXELS, check_size
from torch_radbp.formats.png import check_pixel_data

JPEG_PIXELS = 512  # that a byte of a JPEG file can stand for: 8 x 8 of them take a bit at least
GREY_AND_ALPHA_OF_16_BITS = b"\x10\x04"  # depth and colour type of a PNG header, which begins at byte 8
WIDE = ("PNG", "TIFF")  # of which ";16" in the layout means 16 bits of each number
WITH_ALPHA = ("PNG", "TGA", "WEBP", "TIFF")
ALPHA_MODES = ("RGBA", "LA", "PA")
BITS, PHOTOMETRIC, PLANAR = 258, 262, 284  # tags of TIFF
ORIENTATION = 274  # of EXIF
TURNED = (5, 6, 7, 8)  # orientations that exchange width and height

Source = str | os.PathLike | BinaryIO


def read_pixels(path: str | os.PathLike, kind: str) -> np.ndarray:
    """(H, W, C) float32 values in [0, 1] as they are coded: grey or colour, and alpha, by which they are not multiplied.

    Args:
        path: the file.
        kind: one of Pillow's, such as PNG.

    Raises:
        ValueError: if it is damaged, has several pages, numbers of more than 16 bits, or 16 bits in a layout of which Pillow
            reads eight.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", Image.DecompressionBombWarning)  # TIFF asks again when it is decoded
        return _pixels(path, kind, os.path.getsize(path))


def _pixels(path: str | os.PathLike, kind: str, held: int) -> np.ndarray:
    with open_picture(path, kind, held) as file:
        if kind in ("WEBP", "TIFF") and getattr(file, "n_frames", 1) > 1:
            raise ValueError(f"it has {file.n_frames} pictures; keep one")
        file.verify()  # the check sums of PNG, which reading ignores
    if kind == "PNG":
        with opened(path) as content:
            check_pixel_data(content)
            content.seek(0)
            header = content.read(26)
            if header[24:] == GREY_AND_ALPHA_OF_16_BITS:
                content.seek(0)
                return grey_and_alpha(content.read())
    with open_picture(path, kind, held) as file:
        raw = rawmode(file)
        if kind == "TIFF":
            check_tiff(file)
        if file.mode.startswith("I"):
            grey = np.asarray(file).astype(np.uint16)
            if kind == "TIFF" and file.tag_v2.get(PHOTOMETRIC) == 0:  # 0 is white, which Pillow undoes for 8 bits alone
                grey = (4095 if raw == "I;12" else 65535) - grey
            return with_key(grey[:, :, None], file, 4095 if raw == "I;12" else 65535)
        if kind not in WIDE or ";16" not in raw:
            return _bytes_of(file, kind) / np.float32(255)
        if not raw.startswith(("RGB;", "RGBA;", "RGBX;")):
            raise ValueError(f"16 bits in the layout {raw} are not supported; write RGB, or RGBA that is not multiplied by "
                             f"alpha")
        high = np.asarray(file).astype(np.uint16)
    with open_picture(path, kind, held) as file:
        # Pillow keeps 8 bits of 16-bit colour, the high byte of each pair. Told the other order, it keeps the low one.
        native = "B" if sys.byteorder == "big" else "L"
        other = {"B": "L", "L": "B"}[raw[-1] if raw[-1] in "BL" else native]
        set_rawmode(file, raw[:-1] + other)
        return with_key((high << 8) | np.asarray(file), file, 65535)


def check_tiff(file: TiffImageFile) -> None:
    """Raises ValueError for TIFF layouts that Pillow reads wrongly, and for files with missing pixels."""
    apart = file.tag_v2.get(PLANAR, 1) != 1
    if apart and (set(file.tag_v2[BITS]) != {8} or "RGB" not in file.mode):
        raise ValueError("its channels are stored one after the other, which is supported of RGB with 8 bits; store them "
                         "pixel by pixel")
    if file.mode in ("I", "F"):
        raise ValueError("its numbers have 32 bits; supported are 8 and 16: write an EXR")
    there = sum((right - left) * (lower - upper) for left, upper, right, lower in (tile.extents for tile in file.tile))
    wanted = file.size[0] * file.size[1] * (len(file.tag_v2[BITS]) if apart and len(file.tile) > 1 else 1)
    if there < wanted:
        raise ValueError(f"its strips have {there} of {wanted} pixels; is the file damaged?")


def with_key(words: np.ndarray, file: Image.Image, most: int) -> np.ndarray:
    """(H, W, C) integers as values in [0, 1]; alpha is 0 at the transparent colour, if the file names one."""
    values, key = words / np.float32(most), file.info.get("transparency")
    if key is None or words.shape[2] not in (1, 3):
        return values
    alpha = (words != np.asarray(key).reshape(-1)).any(axis=2, keepdims=True)
    return np.concatenate([values, alpha.astype(np.float32)], axis=2)


def _bytes_of(file: Image.Image, kind: str) -> np.ndarray:
    """(H, W, C) bytes of an image, alpha last if there is one."""
    grey = file.mode in ("1", "L", "LA")
    alpha = kind in WITH_ALPHA and (file.mode in ALPHA_MODES or "transparency" in file.info)
    pixels = np.asarray(file.convert("RGBA" if alpha else "L" if grey else "RGB"))
    return pixels[:, :, [0, 3]] if grey and alpha else pixels[:, :, None] if grey else pixels


def grey_and_alpha(content: bytes) -> np.ndarray:
    """(H, W, 2) values of a 16-bit PNG of grey and alpha, of which Pillow keeps eight bits.

    Its rows are those of a file of four channels in 8 bits, which its header is made to say.
    """
    header = content[12:24] + b"\x08\x06" + content[26:29]
    content = content[:12] + header + struct.pack(">I", zlib.crc32(header)) + content[33:]
    with open_picture(io.BytesIO(content), "PNG", len(content)) as file:
        pairs = np.asarray(file).astype(np.uint16)
    return ((pairs[:, :, 0::2] << 8) | pairs[:, :, 1::2]) / np.float32(65535)


def rawmode(file: Image.Image) -> str:
    """The layout of an image's bytes as Pillow's "raw mode"; "" if its decoder does not say."""
    args = file.tile[0].args if file.tile else ""
    first = args[0] if isinstance(args, tuple) and args else args
    return first if isinstance(first, str) else ""


def set_rawmode(file: Image.Image, raw: str) -> None:
    """Makes Pillow read the bytes of an image in the given layout."""
    file.tile = [tile._replace(args=(raw, *tile.args[1:]) if isinstance(tile.args, tuple) else raw) for tile in file.tile]


def open_picture(source: Source, kind: str, held: int) -> Image.Image:
    """Opens an image with Pillow, without decoding its pixels.

    Args:
        source: the file.
        kind: such as JPEG.
        held: how many bytes it has.

    Raises:
        ValueError: if it is larger than what is read, or than what its bytes can hold.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", Image.DecompressionBombWarning)  # below our own limit, too
        try:
            picture = Image.open(source, formats=(kind,))
        except Image.DecompressionBombError:
            raise ValueError(f"an image may have 1 to {MAX_PIXELS} pixels, this one has more") from None
    try:
        check_size(*picture.size)
        _check_held(kind, *picture.size, held)
    except ValueError:
        picture.close()
        raise
    return picture


def _check_held(kind: str, width: int, height: int, held: int) -> None:
    """Raises ValueError if a JPEG file of `held` bytes is too short for its pixels; the decoder would fill in grey."""
    if kind == "JPEG" and width * height > JPEG_PIXELS * held:
        raise ValueError(f"its {width} x {height} pixels cannot be in {held} bytes; is the file cut short?")


def turned_by(path: Path, kind: str) -> int | None:
    """The EXIF orientation of a picture, if it exchanges the width and the height of the stored pixels; else None.

    The orientation of TIFF is part of that format, and Pillow has done it already.
    """
    if kind in ("EXR", "HDR", "PFM", "TIFF"):
        return None
    try:
        with open_picture(path, kind, os.path.getsize(path)) as file:
            orientation = file.getexif().get(ORIENTATION)
    except (OSError, SyntaxError, ValueError, LookupError):
        return None
    return orientation if orientation in TURNED else None
