"""The files that a run reads, scene, meshes, pictures and targets, and their digests: whether one has changed since."""

import hashlib
import os
from collections.abc import Iterable
from pathlib import Path

PIECE = 2**20  # bytes at a time


def digests(paths: Iterable[Path], folder: Path) -> dict[str, str]:
    """SHA-256 of files, in hexadecimal, by their paths relative to a folder."""
    return {Path(os.path.relpath(path, folder)).as_posix(): digest(path) for path in sorted(paths)}


def digest(path: Path) -> str:
    """SHA-256 of a file, in hexadecimal."""
    found = hashlib.sha256()
    with path.open("rb") as file:
        while piece := file.read(PIECE):
            found.update(piece)
    return found.hexdigest()
