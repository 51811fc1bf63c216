"""Files to be read, with errors that name them."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import BinaryIO


@contextmanager
def opened(path: str | os.PathLike) -> Iterator[BinaryIO]:
    """The file at `path`, open to read bytes.

    Raises:
        FileNotFoundError: if there is no such file.
        IsADirectoryError: if it is a folder.
        OSError: if it cannot be opened or read, or is no ordinary file (a pipe, a device).
    """
    check_source(path)
    try:
        with open(path, "rb") as file:
            yield file
    except OSError as error:
        raise type(error)(f"{path}: cannot be read: {error.strerror or error}") from error


def check_source(path: str | os.PathLike) -> None:
    """Raises as `opened` does unless `path` is an ordinary file."""
    if os.path.isdir(path):
        raise IsADirectoryError(f"{path}: is a folder, not a file")
    if not os.path.exists(path):
        raise FileNotFoundError(f"{path}: file not found")
    if not os.path.isfile(path):
        raise OSError(f"{path}: is not an ordinary file")
