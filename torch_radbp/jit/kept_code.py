"""Machine code of a GPU's kernels on disk, by what they compute and for which architecture.

The folder is `torch_radbp/kernels` in the platform's folder for caches, or what the environment variable
RADBP_KERNEL_CACHE names. Files are written beside their place and moved there, so several processes may write the same one;
one that is damaged is made anew. Nothing is ever taken out: delete the folder at any time.
"""

from __future__ import annotations

import hashlib
import os
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import llvmlite

MARK = b"radbp kernel 1\n"  # what a file begins with, before the digest of its code


def folder() -> Path:
    """Where machine code is kept."""
    if chosen := os.environ.get("RADBP_KERNEL_CACHE"):
        return Path(chosen)
    if sys.platform == "win32":
        base = Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    elif sys.platform == "darwin":
        base = Path.home() / "Library" / "Caches"
    else:
        base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return base / "torch_radbp" / "kernels"


def machine_code(text: str, architecture: str, make: Callable[[str], bytes]) -> bytes:
    """The machine code of a module, from disk if it was made before.

    Args:
        text: LLVM's, which tells all that the kernel computes.
        architecture: such as "sm_90".
        make: makes the machine code of `text`. Where nothing can be written it is called each time.
    """
    name = hashlib.sha256("\n".join([llvmlite.__version__, architecture, text]).encode()).hexdigest()
    path = folder() / architecture / f"{name}.cubin"
    code = read(path)
    if code is None:
        code = make(text)
        write(path, code)
    return code


def read(path: Path) -> bytes | None:
    """What `write` wrote; None if there is nothing, or it is damaged."""
    try:
        found = path.read_bytes()
    except OSError:
        return None
    digest, code = found[len(MARK):len(MARK) + 32], found[len(MARK) + 32:]
    return code if found.startswith(MARK) and hashlib.sha256(code).digest() == digest else None


def write(path: Path, code: bytes) -> None:
    """Puts machine code in its place at once; leaves it where the disk is full or read-only."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, beside = tempfile.mkstemp(dir=path.parent, suffix=".part")
    except OSError:
        return
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(MARK + hashlib.sha256(code).digest() + code)
        os.replace(beside, path)
    except OSError:
        Path(beside).unlink(missing_ok=True)


def refused(code: bytes, complaint: bytes) -> str:
    """What the assembler said of PTX that it did not take, and the file in which that is left for whoever looks into it."""
    said = complaint.partition(b"\0")[0].decode(errors="replace").strip() or "nothing"
    handle, name = tempfile.mkstemp(prefix="torch_radbp-", suffix=".ptx")
    with os.fdopen(handle, "wb") as file:
        file.write(code.rstrip(b"\0"))
    return f"The assembler said: {said}. Its input is {name}"
