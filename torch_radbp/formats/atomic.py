"""Files that are written completely or not at all."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


def check_target(path: Path) -> None:
    """Raises FileNotFoundError or IsADirectoryError if no file can be written at `path`."""
    if not path.parent.is_dir():
        raise FileNotFoundError(f"{path}: the folder {path.parent} does not exist; create it first")
    if path.is_dir():
        raise IsADirectoryError(f"{path}: is a folder, not a file")


@contextmanager
def replacing(path: str | os.PathLike) -> Iterator[Path]:
    """A temporary path of the same name, moved to `path` when the block ends well and removed otherwise.

    Raises:
        FileNotFoundError: if the folder of `path` does not exist.
        IsADirectoryError: if `path` is a folder.
        OSError: names `path` if it cannot be written: the disk is full, the folder read-only.
    """
    path = Path(path)
    check_target(path)
    with naming(path), tempfile.TemporaryDirectory(dir=path.parent, prefix=f".{path.name}.") as folder:
        temporary = Path(folder) / path.name
        yield temporary
        os.replace(temporary, path)


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Failures to write in the block become an OSError that names `path`, with the number of the system's error if any.

    Libraries written in C++ report a full disk as RuntimeError.
    """
    try:
        yield
    except (OSError, RuntimeError) as error:
        reason = getattr(error, "strerror", None) or " ".join(str(error).split())
        named = OSError(f"{path}: cannot be written: {reason}")
        named.errno = getattr(error, "errno", None)
        raise named from error
