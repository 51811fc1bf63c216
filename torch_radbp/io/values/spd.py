"""Reads spectra from .spd files: a wavelength in nanometres and a value in each line, comments behind #."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from torch_radbp.formats.files import opened
from torch_radbp.formats.text_lines import read_lines
from torch_radbp.texture.spectrum import Samples


def read_spectrum(path: str | os.PathLike) -> Samples:
    """Reads a spectrum from an .spd file.

    Raises:
        FileNotFoundError: if there is no such file.
        OSError: if it cannot be read.
        ValueError: on another extension, on lines that are not two numbers, which are named, and as `Samples.check` does.
    """
    if Path(path).suffix.lower() != ".spd":
        raise ValueError(f"{path}: unknown kind of spectrum {Path(path).suffix!r}; supported: .spd")
    pairs: list[list[float]] = []
    with opened(path) as file:
        for lines in read_lines(file, str(path), comments=True):
            lengths = lines.first[1:] - lines.first[:-1]
            if (lengths != 2).any():
                row = int((lengths != 2).argmax())
                raise ValueError(f"{path}, line {lines.numbers[row]}: a line must have a wavelength and a value, got "
                                 f"{lengths[row]} words")
            pairs += lines.values(np.arange(len(lines.starts)), str(path)).reshape(-1, 2).tolist()
    try:
        return Samples(tuple(pair[0] for pair in pairs), tuple(pair[1] for pair in pairs)).check()
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
