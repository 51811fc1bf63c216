"""What lanes are compiled for: a processor with vectors (`cpu.py`) or a GPU (`nvptx.py`).

A target knows what stands around the instructions of a block of lanes, makes machine code of both and runs it. The
instructions themselves are those of `emit.py` for all.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Protocol

import torch

from torch_radbp.jit.cpu import Cpu
from torch_radbp.jit.graph import Program
from torch_radbp.jit.nvptx import nvptx_of


class Loop(Protocol):
    """A program as machine code."""

    def run(self, lanes: int, inputs: Sequence[int], lengths: Sequence[int], outputs: Sequence[int]) -> None:
        """Computes all lanes; what torch does next on the same device finds the results.

        Args:
            lanes: how many, at least 1.
            inputs, lengths: of each input of the program its address and its number of entries.
            outputs: of each output the address.
        """


class Target(Protocol):
    """What lanes are compiled for."""

    def text(self, program: Program) -> str:
        """The module of a program, LLVM's text."""

    def compile(self, program: Program) -> Loop:
        """The machine code of a program."""


@functools.cache
def target_of(device: torch.device) -> Target:
    """The target for tensors of a device.

    Raises:
        RuntimeError: on CUDA, if what launches kernels is missing; the message says what.
    """
    return Cpu() if device.type == "cpu" else nvptx_of(device)
