"""NVIDIA's assembler, which needs no GPU: that of the wheel `nvidia-cuda-nvcc-cu12`, or one on the search path."""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
from importlib import metadata
from pathlib import Path
from typing import NamedTuple

WHEEL = "nvidia-cuda-nvcc-cu12"


class Usage(NamedTuple):
    """What a thread of a kernel takes."""

    registers: int
    stack: int  # bytes of local memory, spilled registers among them
    stores: int  # bytes of registers that are spilled
    loads: int  # bytes of them that are fetched again


class Rejected(RuntimeError):
    """The assembler does not take a text; the message is the assembler's."""


def find() -> str | None:
    """The path of the assembler; None: there is none."""
    try:
        files = metadata.files(WHEEL) or []
    except metadata.PackageNotFoundError:
        return shutil.which("ptxas")
    return next((str(file.locate()) for file in files if file.name in ("ptxas", "ptxas.exe")), None)


def assemble(ptx: str, architecture: str, program: str) -> Usage:
    """Assembles a module of one kernel.

    Args:
        ptx: its text.
        architecture: such as "sm_90".
        program: the assembler, from `find`.

    Raises:
        Rejected: if the assembler does not take it.
    """
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder, "kernel.ptx")
        source.write_text(ptx)
        done = subprocess.run([program, f"-arch={architecture}", "-v", str(source), "-o", str(Path(folder, "kernel.cubin"))],
                              capture_output=True, text=True)
    said = done.stdout + done.stderr
    if done.returncode:
        raise Rejected(said)
    stack, stores, loads = map(int, re.search(
        r"(\d+) bytes stack frame, (\d+) bytes spill stores, (\d+) bytes spill loads", said).groups())
    return Usage(int(re.search(r"Used (\d+) registers", said)[1]), stack, stores, loads)
