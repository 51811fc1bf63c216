"""Images: EXR through OpenEXR; PNG, JPEG, BMP, TGA, WebP and TIFF through Pillow; HDR and PFM. In memory: linear float32."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from torch_radbp.formats.atomic import replacing
from torch_radbp.formats.exr import read_exr, write_exr
from torch_radbp.formats.files import opened, unknown_kind
from torch_radbp.formats.memory import memory_for
from torch_radbp.formats.pfm import read_pfm
from torch_radbp.formats.picture_size import check_size
from torch_radbp.formats.pillow import read_pixels
from torch_radbp.formats.radiance import read_radiance

READABLE = {".exr": "EXR", ".png": "PNG", ".jpg": "JPEG", ".jpeg": "JPEG", ".bmp": "BMP", ".tga": "TGA", ".hdr": "HDR",
            ".pfm": "PFM", ".webp": "WEBP", ".tif": "TIFF", ".tiff": "TIFF"}
WRITABLE = (".exr", ".png")
LINEAR = ("EXR", "HDR", "PFM")
SIGNATURES = {"EXR": b"\x76\x2f\x31\x01", "PNG": b"\x89PNG\r\n\x1a\n", "JPEG": b"\xff\xd8\xff", "BMP": b"BM",
              "HDR": b"#?", "PFM": (b"PF", b"Pf"), "WEBP": b"RIFF",
              "TIFF": (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"), "TGA": b""}  # TGA has none


def read_image(path: str | os.PathLike, raw: bool = False) -> Tensor:
    """Reads an image.

    EXR: half and float, all compressions; channels R, G, B or Y, also inside a layer (`beauty.R`). HDR: Radiance's RGBE.
    PFM: grey and colour. PNG, JPEG, BMP, TGA, WebP and TIFF: grey, colour and palette, 8 or 16 bits. Alpha is dropped in
    every format, without multiplying by it. Pixels are as they are stored, whatever the orientation in EXIF data; that of
    a TIFF file is part of its format, and counts.

    Args:
        path: the file; its extension says what it is.
        raw: take values as linear instead of decoding sRGB. EXR, HDR and PFM are always linear.

    Returns:
        (H, W, C) float32, C = 1 for grey images and 3 otherwise; row 0 is at the top.

    Raises:
        FileNotFoundError: if there is no such file.
        IsADirectoryError: if it is a folder.
        ValueError: on unknown extensions, damaged files, files cut short or of another format than their extension says,
            EXR files without a colour, and images of more than `MAX_PIXELS` pixels.
        MemoryError: names the file, if there is not enough memory.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in READABLE:
        raise ValueError(unknown_kind(path, "image", READABLE))
    kind = READABLE[suffix]
    _check_signature(path, kind)
    with memory_for(path):
        image = torch.from_numpy(np.ascontiguousarray(_pixels(path, kind), dtype=np.float32))
        return image if raw or kind in LINEAR else srgb_to_linear(image)


def _pixels(path: str | os.PathLike, kind: str) -> np.ndarray:
    """(H, W, 1 or 3) values of an image file as they are coded; raises as `read_image`."""
    try:
        return READERS[kind](path) if kind in READERS else colours(read_pixels(path, kind))
    except MemoryError:
        raise
    except Exception as error:  # the libraries raise whatever their decoders stumble over
        inner = isinstance(error, (LookupError, ArithmeticError, UnicodeError))  # whose messages speak of their own code
        reason = "its content is damaged" if inner else " ".join(str(error).split())
        raise ValueError(f"{path}: cannot be read as {kind}: {reason}") from error


def save_image(path: str | os.PathLike, image: Tensor, channels: Mapping[str, Tensor] | None = None, *,
               curve: str = "srgb", white: float = 1.0, bits: int = 8) -> None:
    """Writes an image, completely or not at all.

        rb.save_image("image.exr", rb.render(scene, spp=16)[0])
        aovs = renderer.aovs(["hit", "depth"], seed=0)
        rb.save_image("mask.png", aovs["hit"][0], curve="linear")  # for rb.Photographs
        # Depths in thousandths:
        rb.save_image("depth.png", aovs["depth"][0], curve="linear", white=65.535, bits=16)

    Args:
        path: .exr (float32, linear) or .png (whole numbers; values cut to [0, `white`]).
        image: (3, H, W) linear RGB of any floating dtype and device; one of the (B, 3, H, W) that a renderer returns. Or
            (4, H, W), with alpha, or (1, H, W), grey: a mask or depths, a mask also as truth values.
        channels: more of them by name, (H, W) each; of .exr only.
        curve: by which a .png codes colours and grey: "srgb" for what is looked at, "linear" for what is measured. Alpha is
            linear in either.
        white: the value, but for alpha, that is the largest number of a .png.
        bits: of a .png: 8, or for one channel also 16.

    Raises:
        TypeError: if `image` is no dense tensor of floating point numbers, or of truth values.
        ValueError: on unknown extensions, curves and other shapes, values that are NaN or infinite, more channels in a .png,
            16 bits of colour, and `white` or `bits` of an .exr.
        FileNotFoundError: if the folder does not exist.
        OSError: names the file if it cannot be written.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in WRITABLE:
        raise ValueError(f"{path}: unknown kind of image {suffix!r}; supported: {', '.join(WRITABLE)}")
    if curve not in CURVES:
        raise ValueError(f"{path}: curve must be {' or '.join(CURVES)}, got {curve!r:.60}")
    if bits not in LARGEST or not 0 < white < float("inf"):
        raise ValueError(f"{path}: bits must be 8 or 16 and white greater than 0, got {bits!r:.60} and {white!r:.60}")
    if suffix == ".exr" and (bits, white) != (8, 1):
        raise ValueError(f"{path}: an .exr has the values as they are: leave bits and white out, or write a .png")
    if isinstance(image, Tensor) and image.dtype == torch.bool:
        image = image.float()
    if not isinstance(image, Tensor) or not image.is_floating_point():
        got = image.dtype if isinstance(image, Tensor) else type(image).__name__
        raise TypeError(f"{path}: an image must be a tensor of floating point numbers, got {got}")
    if image.ndim != 3 or image.shape[0] not in (1, 3, 4) or image.numel() == 0:
        raise ValueError(f"{path}: an image must have shape (3, H, W), got {tuple(image.shape)}{_advice(image)}")
    if bits == 16 and len(image) != 1:
        raise ValueError(f"{path}: a .png of 16 bits is written of one channel, (1, H, W), got {tuple(image.shape)}")
    named = {**dict(zip("Y" if len(image) == 1 else "RGBA", image)), **(channels or {})}
    if channels and suffix != ".exr":
        raise ValueError(f"{path}: a {suffix} has no channels for {', '.join(channels)}; write an .exr")
    for name, channel in named.items():
        if not isinstance(channel, Tensor) or channel.is_meta or channel.layout != torch.strided:
            got = type(channel).__name__ if not isinstance(channel, Tensor) else "one on the device meta, which holds none" \
                if channel.is_meta else f"one of {channel.layout}, which .to_dense() makes dense"
            raise TypeError(f"{path}: channel {name!r} must be a dense tensor of numbers, got {got}")
        if channel.shape != image[0].shape:
            raise ValueError(f"{path}: channel {name!r} must have shape {tuple(image[0].shape)}, got {tuple(channel.shape)}")
    pixels = torch.stack([channel.detach().to("cpu", torch.float32) for channel in named.values()])
    bad = int((~torch.isfinite(pixels)).any(dim=0).sum())
    if bad:
        raise ValueError(f"{path}: not written, {bad} of {image[0].numel()} pixels are NaN or infinite in float32")
    with replacing(path) as temporary:
        if suffix == ".exr":
            write_exr(temporary, {name: channel.numpy() for name, channel in zip(named, pixels)})
        else:
            shares = torch.cat([CURVES[curve]((pixels[:3] / white).clamp(0.0, 1.0)), pixels[3:].clamp(0.0, 1.0)])
            levels = (shares * LARGEST[bits].max).round().permute(1, 2, 0).contiguous().numpy()
            levels = levels.astype(LARGEST[bits].dtype)
            Image.fromarray(levels[..., 0] if len(image) == 1 else levels).save(temporary)


def _advice(image: Tensor) -> str:
    """What to do about an image of the wrong shape, for an error message."""
    if image.ndim == 4 and image.shape[1] == 3:
        return f", a batch of {image.shape[0]}; pick one, image[0]"
    if image.ndim == 3 and image.shape[2] == 3:
        return "; move the channels to the front, image.movedim(-1, 0)"
    return ""


LARGEST = {8: np.iinfo(np.uint8), 16: np.iinfo(np.uint16)}  # numbers of a PNG, by its bits


def srgb_to_linear(values: Tensor) -> Tensor:
    """Decodes sRGB. Reference: IEC 61966-2-1."""
    return torch.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055).clamp_min(0.0) ** 2.4)


def linear_to_srgb(values: Tensor) -> Tensor:
    """Encodes sRGB, with finite derivatives everywhere. Reference: IEC 61966-2-1."""
    # The power's derivative is infinite at 0; torch.where would turn that into NaN.
    power = 1.055 * values.clamp_min(0.0031308) ** (1 / 2.4) - 0.055
    return torch.where(values <= 0.0031308, values * 12.92, power)


CURVES: dict[str, Callable[[Tensor], Tensor]] = {"srgb": linear_to_srgb, "linear": lambda values: values}  # that code


def _check_signature(path: str | os.PathLike, kind: str) -> None:
    """Raises ValueError unless the file begins with the signature of its format; other errors as `opened`."""
    with opened(path) as file:
        begin = file.read(8)
    if begin.startswith(SIGNATURES[kind]):
        return
    other = next((name for name, signature in SIGNATURES.items() if signature and begin.startswith(signature)), None)
    problem = f"begins as {other} does; change its extension" if other else f"begins with {begin!r}" if begin else "is empty"
    raise ValueError(f"{path}: cannot be read as {kind}: the file {problem}")


def colours(pixels: np.ndarray) -> np.ndarray:
    """Drops alpha: (H, W, 1 or 3) of (H, W, 1 to 4) pixels, whose alpha comes last."""
    return pixels[:, :, :3 if pixels.shape[2] > 2 else 1]


READERS: dict[str, Callable[[str | os.PathLike], np.ndarray]] = {
    kind: partial(read, check_size=check_size)
    for kind, read in (("EXR", read_exr), ("HDR", read_radiance), ("PFM", read_pfm))}
