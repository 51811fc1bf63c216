"""The interface of targets: what lanes are compiled for, a CPU (`cpu/cpu.py`) or a GPU (`nvidia/gpu.py`).

A target knows what stands around the instructions of a block of lanes, makes machine code of both and runs it; the
instructions themselves are those of `lane/emit.py` for all. It also moves lanes about, as `order.py` and `scatter.py` say.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import torch
from torch import Tensor

from torch_radbp.jit.cpu.cpu import Cpu
from torch_radbp.jit.cpu.recorded import Recorded
from torch_radbp.jit.lane.graph import Program
from torch_radbp.jit.nvidia.gpu import gpu_of
from torch_radbp.jit.nvidia.recorded_launches import RecordedLaunches
from torch_radbp.jit.recording.addition import Addition, Patches
from torch_radbp.jit.recording.any_device import AnyDevice
from torch_radbp.jit.recording.recording import Recording

COMPILED = ("cpu", "cuda")  # kinds of devices that functions are compiled for


class Loop(Protocol):
    """A compiled program, ready to run."""

    def run(self, lanes: int, inputs: Sequence[int], lengths: Sequence[int], outputs: Sequence[int]) -> None:
        """Computes all lanes; later operations of torch on the same device see the results.

        Args:
            lanes: how many, at least 1.
            inputs, lengths: of each input of the program its address and its number of entries.
            outputs: of each output the address.
        """


class Target(Protocol):
    """A device for which functions of lanes are compiled.

    Attributes:
        counts_stay: numbers of lanes that a recording finds stay on the device, which runs it as launches for all lanes;
            else recordings may be run one after the other tile by tile, see `tiles.py`.
        loads_ahead: code is loaded in the background as soon as it is made, and not at the first run.
        repeats: code goes on with a lane by itself where a stage may be repeated, see `tensors.stage.stage`.
    """

    counts_stay: bool
    loads_ahead: bool
    repeats: bool

    def text(self, program: Program) -> str:
        """The LLVM IR of a program."""

    @property
    def platform(self) -> str:
        """All that code depends on beside the program, as a key of caches.

        Raises:
            RuntimeError: if nothing can be compiled for this target; the message says what is missing.
        """

    def code(self, program: Program) -> bytes:
        """Compiles a program: to machine code, or to what the device's driver takes."""

    def loop(self, code: bytes, searched: Sequence[int], keep: Callable[[bytes], None] | None = None) -> Loop:
        """Loads compiled code.

        Args:
            code: from `code`.
            searched: the indices of the inputs whose lengths it needs.
            keep: is given better code for other processes, if there ever is.
        """

    def compile(self, program: Program) -> Loop:
        """Compiles and loads a program."""

    def recorded(self, recording: Recording, given: Sequence[Tensor | int], results: Any) -> Recorded | RecordedLaunches:
        """Prepares a recording to be played; args as for `results.RecordedResults`.

        Raises:
            NotRecordable: if it cannot be played; the message says why.
        """

    def chosen(self, flags: Tensor) -> Tensor:
        """The lanes whose flag is set; see `order.chosen`."""

    def inverted(self, flags: Tensor) -> Tensor:
        """Negates the flags of lanes; see `order.inverted`."""

    def nothing(self, flags: Tensor) -> Tensor:
        """Flags that are all false; see `order.nothing`."""

    def partition(self, number: Tensor, queues: int) -> tuple[Tensor, Sequence[int]]:
        """Sorts lanes into queues; see `order.partition`."""

    def in_order(self, major: Tensor, minor: Tensor, queues: int) -> tuple[Tensor, Tensor, Tensor]:
        """Sorts lanes by two numbers; see `order.in_order`."""

    def put(self, targets: Sequence[Tensor], place: Tensor, entries: Sequence[Tensor]) -> None:
        """Scatters entries, at least 1 each, all contiguous; see `order.put`."""

    def copies(self, entries: int) -> int:
        """The best number of copies in which a table of gradients is summed; see `scatter.copies`."""

    def scatter_add(self, additions: Sequence[Addition], lanes: int) -> None:
        """Scatter-adds numbers of at least 1 lane, all contiguous; see `scatter.scatter_add`."""

    def add_patches(self, patches: Patches, totals: Tensor) -> None:
        """Adds values of at least 1 lane to rectangles of pixels, all contiguous; see `patches.add_patches`."""


@functools.cache
def target_of(device: torch.device) -> Target:
    """The target for functions whose tensors lie on a device: the CPU, a GPU, or one for which nothing is compiled."""
    return Cpu() if device.type == "cpu" else gpu_of(device) if device.type == "cuda" else AnyDevice()
