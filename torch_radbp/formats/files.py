"""Opens files for reading, with errors that name them."""

from __future__ import annotations

import os
import unicodedata
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import BinaryIO

# The files that have been opened since `opened_files` was entered; None outside of it.
_OPENED: ContextVar[set[Path] | None] = ContextVar("_OPENED", default=None)


@contextmanager
def opened_files() -> Iterator[set[Path]]:
    """Collects the absolute paths of all files that are opened in the block."""
    paths: set[Path] = set()
    token = _OPENED.set(paths)
    try:
        yield paths
    finally:
        _OPENED.reset(token)


@contextmanager
def opened(path: str | os.PathLike) -> Iterator[BinaryIO]:
    """Opens the file at `path` to read bytes.

    Raises:
        FileNotFoundError: if there is no such file.
        IsADirectoryError: if it is a folder.
        OSError: if it cannot be opened or read, or is no ordinary file (a pipe, a device).
    """
    check_source(path)
    try:
        with open(path, "rb") as file:
            if (paths := _OPENED.get()) is not None:
                paths.add(Path(os.path.abspath(path)))
            yield file
    except OSError as error:
        raise type(error)(f"{path}: cannot be read: {error.strerror or error}") from error


def unknown_kind(path: str | os.PathLike, what: str, supported: Iterable[str]) -> str:
    """The message about a path whose extension is not one of those `supported` for `what`, or which is no file at all."""
    if os.path.isdir(path):
        return f"{path}: is a folder, not a file"
    if os.path.exists(path) and not os.path.isfile(path):
        return f"{path}: is not an ordinary file"
    suffix = os.path.splitext(path)[1].lower()
    return f"{path}: unknown kind of {what} {suffix!r}; supported: {', '.join(supported)}"


def check_source(path: str | os.PathLike) -> None:
    """Raises as `opened` does unless `path` is an ordinary file."""
    if os.path.isdir(path):
        raise IsADirectoryError(f"{path}: is a folder, not a file")
    if not os.path.exists(path):
        like = otherwise_spelled(path)
        raise FileNotFoundError(f"{path}: file not found{f'; did you mean {like}?' if like else ''}")
    if not os.path.isfile(path):
        raise OSError(f"{path}: is not an ordinary file")


def otherwise_spelled(path: str | os.PathLike) -> Path | None:
    """An existing path that differs from this one only in case, or in how accents are coded; or None."""
    place = Path(Path(path).anchor)
    for part in Path(path).parts[len(place.parts):]:
        if not os.path.lexists(place / part):
            try:
                part = next((name for name in sorted(os.listdir(place)) if folded(name) == folded(part)), None)
            except OSError:
                part = None
            if part is None:
                return None
        place /= part
    return place if place.is_file() else None


def folded(name: str) -> str:
    """A name without differences of case, and of composed and decomposed accents."""
    return unicodedata.normalize("NFC", name).casefold()
