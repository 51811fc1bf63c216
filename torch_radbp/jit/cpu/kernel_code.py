"""Machine code of a kernel: made quickly, and well where there is much for it to do.

Without optimising LLVM makes code in a third of the time, and loops take up to twice as long. So a kernel that is first
needed by a small rendering begins with such code. Once it has had so many lanes that better code pays, in this process and
those before, or has run so often that it is part of a long training, a helper makes that, and whoever runs the kernel next
takes it; a larger rendering has only the better one. Both compute the same bits, for what LLVM might round otherwise is said
by the program (`lane/fused.py`).
"""

from __future__ import annotations

import pickle
import zlib
from array import array
from collections.abc import Callable, Sequence
from typing import NamedTuple

from torch_radbp.jit.cpu.machine import MachineCode, object_code
from torch_radbp.threads.later import Later
from torch_radbp.threads.team import run_lanes

MANY = 1 << 16  # paths of a rendering that is not small
LONGEST = 1 << 14  # lines of a kernel whose values, which all lie on the stack if it is made quickly, find room there
ENOUGH = 1 << 21  # lanes, bounce by bounce, for which better code pays beside the first
LEAST = 1 << 12  # that a run counts as
WRITTEN = 16  # parts of these lanes after each of which they are written down, for later processes, most of which are short


class KernelCode(NamedTuple):
    """Machine code of a kernel, with the LLVM IR of which better code is made if this was made quickly."""

    object: bytes  # an object file
    text: bytes  # the LLVM IR, compressed; empty: it is made well
    lanes: int = 0  # that it has had in earlier processes, as far as they are written down

    @staticmethod
    def first(text: str) -> KernelCode:
        """Compiles LLVM IR for the rendering that runs: well if it is large, or the text long, else quickly."""
        return KernelCode.made(text, well=Ahead.are_many() or text.count("\n") > LONGEST)

    @staticmethod
    def made(text: str, well: bool) -> KernelCode:
        """Compiles LLVM IR to machine code, `well` with LLVM's optimisations, else quickly without."""
        return KernelCode(object_code(text, well), b"" if well else zlib.compress(text.encode(), 1))

    def better(self) -> KernelCode:
        """The code of the same kernel, compiled once more with LLVM's optimisations."""
        return self.made(zlib.decompress(self.text).decode(), well=True)

    def packed(self) -> bytes:
        return pickle.dumps(tuple(self))


class Ahead:
    """The number of paths of the rendering that runs, by which kernels are compiled quickly or well; one for all threads."""

    paths = 0

    @staticmethod
    def are(paths: int) -> None:
        """Says how many paths the rendering that begins has."""
        Ahead.paths = paths

    @staticmethod
    def are_many() -> bool:
        """True if the rendering that runs has so many paths that well-made code pays."""
        return Ahead.paths >= MANY


class CpuLoop:
    """A kernel's machine code as a loop over lanes, exchanged for better code once it has had many lanes.

    Args:
        code: a packed `KernelCode`.
        keep: writes code into the cache; None: it is not kept.
    """

    def __init__(self, code: bytes, keep: Callable[[bytes], None] | None = None):
        self.made, self.keep = KernelCode(*pickle.loads(code)), keep
        self.loaded = [MachineCode(self.made.object)]  # the last is the best; those before may be running
        self.may_improve = bool(self.made.text)
        self.lanes = self.made.lanes  # counted while it may
        self.improving: Later[None] | None = None

    @property
    def address(self) -> int:
        """The address of the best code so far, a C function that takes parts of a `team.Job`."""
        return self.loaded[-1].address

    def run(self, lanes: int, inputs: Sequence[int], lengths: Sequence[int], outputs: Sequence[int]) -> None:
        """Runs the loop over all lanes, and waits for it."""
        self.takes(max(lanes, LEAST))
        run_lanes(self.address, lanes, array("q", [*inputs, *lengths]), array("q", outputs))

    def takes(self, lanes: int) -> bool:
        """Counts lanes that the code computes, and has better code made once they are many; False if none will be made."""
        if not self.may_improve:
            return False
        self.lanes += lanes
        if self.improving is None and (self.lanes >= ENOUGH or Ahead.are_many()):
            self.improving = Later(self.improve).meanwhile()
        elif self.improving is None and self.lanes - self.made.lanes >= ENOUGH // WRITTEN:
            self.made = self.made._replace(lanes=self.lanes)
            self.write()
        return True

    def improve(self) -> None:
        """Compiles the kernel well, and loads it: whoever asks for the address next gets that of the new code."""
        self.made = self.made.better()
        self.loaded.append(MachineCode(self.made.object))
        self.may_improve = False
        self.write()

    def write(self) -> None:
        """Writes the code into the cache, if it is kept there."""
        if self.keep is not None:
            self.keep(self.made.packed())
