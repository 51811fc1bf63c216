"""A cache of compiled code on disk: entries are named by a digest of all that they depend on.

The folder is `torch_radbp/kernels` in the platform's folder for caches, or what the environment variable
RADBP_KERNEL_CACHE names; `off` keeps nothing. It must belong to the user who runs this, since its code is run. Files are
written beside their place and moved there, so several processes may write the same one; one that is damaged, or of another
name, counts as absent. What was not used for the longest time goes when all takes more than LIMIT. Delete the folder at
any time.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import sys
import tempfile
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

import llvmlite

MARK = b"radbp code 2\n"  # what a file begins with, before the digest of its name and contents
DIGEST = hashlib.sha256().digest_size
SUFFIX = ".code"
LIMIT = 1 << 30  # bytes of all files
OFF = "off"


def folder() -> Path | None:
    """The folder of the cache; None: it is switched off."""
    if chosen := os.environ.get("RADBP_KERNEL_CACHE"):
        return None if chosen == OFF else Path(chosen)
    if sys.platform == "win32":
        base = Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    elif sys.platform == "darwin":
        base = Path.home() / "Library" / "Caches"
    else:
        base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return base / "torch_radbp" / "kernels"


@functools.cache
def belongs_to_user(place: Path) -> bool:
    """True if a folder, created if necessary, belongs to this user and nobody else may write into it."""
    try:
        place.mkdir(mode=0o700, parents=True, exist_ok=True)
        state = place.stat()
    except OSError:
        return False
    return not hasattr(os, "getuid") or (state.st_uid == os.getuid() and not state.st_mode & 0o022)


def _path_of(name: str) -> Path | None:
    """The file of an entry; None if the cache is switched off."""
    place = folder()
    return place / f"{name}{SUFFIX}" if place is not None and belongs_to_user(place) else None


def digest(name: str, contents: bytes) -> bytes:
    return hashlib.sha256(name.encode() + b"\n" + contents).digest()


def read_code(name: str) -> bytes | None:
    """Reads an entry; None if there is none, or it is damaged."""
    path = _path_of(name)
    if path is None:
        return None
    try:
        found = path.read_bytes()
    except OSError:
        return None
    start = len(MARK) + DIGEST
    if not found.startswith(MARK) or digest(name, found[start:]) != found[len(MARK):start]:
        return None
    with contextlib.suppress(OSError):
        os.utime(path)  # it was used now
    return zlib.decompress(found[start:])


def write_code(name: str, code: bytes) -> None:
    """Writes an entry; fails silently if the disk is full or read-only."""
    path = _path_of(name)
    if path is None:
        return
    try:
        handle, beside = tempfile.mkstemp(dir=path.parent, suffix=".part")
    except OSError:
        return
    contents = zlib.compress(code, 1)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(MARK + digest(name, contents) + contents)
        os.replace(beside, path)
        make_room(path.parent)
    except OSError:
        with contextlib.suppress(OSError):
            Path(beside).unlink(missing_ok=True)


def files(place: Path) -> Iterator[tuple[Path, os.stat_result]]:
    """Yields the files in the cache, and temporary files left behind, with their status."""
    for path in (*place.glob(f"*{SUFFIX}"), *place.glob("*.part")):
        with contextlib.suppress(OSError):  # another process may have deleted it
            yield path, path.stat()


@functools.cache
def make_room(place: Path) -> None:
    """Deletes the least recently used entries until 3/4 of LIMIT are left; once per process and folder."""
    found = sorted(files(place), key=lambda entry: entry[1].st_mtime)
    size = sum(state.st_size for _, state in found)
    if size <= LIMIT:
        return
    for path, state in found:
        if size <= 3 * LIMIT // 4:
            return
        with contextlib.suppress(OSError):
            path.unlink()
        size -= state.st_size


def clear() -> tuple[int, int]:
    """Deletes all entries; returns their number and bytes."""
    place = folder()
    found = [] if place is None or not place.is_dir() else list(files(place))
    for path, _ in found:
        path.unlink(missing_ok=True)
    return len(found), sum(state.st_size for _, state in found)


def machine_code(text: str, architecture: str, make: Callable[[str], bytes]) -> bytes:
    """Compiles a module to machine code, or reads it from the cache.

    Args:
        text: LLVM's, which tells all that the code computes.
        architecture: such as "sm_90", or all that is known of a processor.
        make: makes the machine code of `text`. Where nothing can be written it is called in each process.
    """
    name = hashlib.sha256("\n".join([llvmlite.__version__, architecture, text]).encode()).hexdigest()
    code = read_code(name)
    if code is None:
        code = make(text)
        write_code(name, code)
    return code
