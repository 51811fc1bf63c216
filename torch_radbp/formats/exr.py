"""Reads and writes OpenEXR files through the library of that name."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR

BEAUTY_LAYERS = ("", "rgb", "rgba", "color", "colour", "beauty", "combined", "image")
# Rows that are compressed together, by the name of the compression.
ROWS = {"NO": 1, "RLE": 1, "ZIPS": 1, "ZIP": 16, "PXR24": 16, "PIZ": 32, "B44": 32, "B44A": 32, "DWAA": 32}
MOST_ROWS = 256  # of others
CHUNK_BYTES = 16  # that a chunk takes at least: its entry in the table, its row and its size
DEFLATED = ("NO", "RLE", "ZIPS", "ZIP", "PXR24")  # which shrink a pixel to 1 / DEFLATION bytes at best
DEFLATION = 1032


def read_exr(path: str | os.PathLike, check_size: Callable[[int, int], None]) -> np.ndarray:
    """(H, W, C) linear values of the layer that holds the colour; as `read_exr_with_alpha`."""
    return read_exr_with_alpha(path, check_size)[0]


def read_exr_with_alpha(path: str | os.PathLike,
                        check_size: Callable[[int, int], None]) -> tuple[np.ndarray, np.ndarray | None]:
    """The layer that holds the colour: (H, W, C) linear values, and (H, W) alpha, by which they are multiplied, or None.

    Args:
        path: the file.
        check_size: called with width and height before anything of that size is made.

    Raises:
        ValueError: if the file is damaged, cut short or too short for its pixels, or has no colour, or colours in several
            layers.
    """
    headers = read_headers(path)
    for header in headers:
        low, high = header["dataWindow"]
        width, height = (int(b) - int(a) + 1 for a, b in zip(low, high))
        check_size(width, height)
        _check_held(header, width, height, os.path.getsize(path))
    parts = OpenEXR.File(str(path), separate_channels=True).parts
    if len(parts) < len(headers):  # which it prints and leaves out
        raise ValueError("its pixels are damaged or cut short")
    layers: dict[str, tuple[np.ndarray, np.ndarray | None]] = {}  # layer -> colour and alpha of the first part that has it
    for channels in (part.channels for part in parts):
        for layer in sorted({name.rpartition(".")[0] for name in channels}):
            prefix = f"{layer}." if layer else ""
            colour = layer_colour(channels, prefix)
            if colour is not None:
                alpha = next((channels[name].pixels for name in (f"{prefix}A", f"{prefix}a") if name in channels), None)
                layers.setdefault(layer, (colour, alpha))
    if not layers:
        names = ", ".join(name for part in parts for name in part.channels)
        raise ValueError(f"no colour among its channels {names}; supported: R, G, B or Y, alone or in a layer")
    chosen = [layer for layer in layers if layer.rpartition(".")[2].lower() in BEAUTY_LAYERS] or list(layers)
    if len(chosen) > 1 and "" not in chosen:
        raise ValueError(f"several layers have colours, {', '.join(chosen)}; keep one or call it beauty")
    return layers["" if "" in chosen else chosen[0]]


def layer_colour(channels: dict[str, OpenEXR.Channel], prefix: str) -> np.ndarray | None:
    """The colour of the layer with this prefix: (H, W, 3) from R, G, B, or (H, W, 1) from Y; None if it has none."""
    if f"{prefix}RY" in channels:  # luminance and chroma at reduced resolution
        return None
    for letters in ("RGB", "rgb", "Y"):
        names = [f"{prefix}{letter}" for letter in letters]
        if all(name in channels for name in names):
            return np.stack([channels[name].pixels for name in names], axis=2)
    return None


def read_headers(path: str | os.PathLike) -> list[dict[str, Any]]:
    """Reads the header of each part of an EXR file.

    Raises:
        ValueError: if the library cannot read them.
    """
    try:
        return [part.header for part in OpenEXR.File(str(path), header_only=True).parts]
    except RuntimeError as error:  # which only says that it cannot open the file
        raise ValueError("its header is damaged, or the file is cut short") from error


def _check_held(header: dict[str, Any], width: int, height: int, held: int) -> None:
    """Raises ValueError if a file of `held` bytes is too short for the pixels of one of its parts."""
    kind = header["compression"].name.removesuffix("_COMPRESSION")
    least = width * height // DEFLATION if kind in DEFLATED else 0
    if header["type"] == OpenEXR.scanlineimage:
        least = max(least, CHUNK_BYTES * -(-height // ROWS.get(kind, MOST_ROWS)))
    if held < least:
        raise ValueError(f"its {width} x {height} pixels cannot be in {held} bytes; is the file cut short?")


def write_exr(path: Path, channels: dict[str, np.ndarray]) -> None:
    """Writes float32 channels, (H, W) each."""
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, dict(channels)).write(str(path))  # a copy: it writes into the dict
    # OpenEXR is silent if the disk is full when it closes the file.
    written = OpenEXR.File(str(path), separate_channels=True).parts[0].channels
    if not all(name in written and np.array_equal(written[name].pixels, values) for name, values in channels.items()):
        raise OSError("what was written reads back differently; the disk may be full")
