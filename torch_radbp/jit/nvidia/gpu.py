"""An NVIDIA GPU as a target: launches the kernels of `nvptx.py` and `nvptx_lanes.py`.

Lanes are chosen and partitioned by torch's own operations, unless it is recorded what is done with them (`launches.py`).
"""

from __future__ import annotations

import ctypes
from array import array
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from functools import cached_property, partial
from threading import Lock
from typing import Any, Protocol

import torch
from torch import Tensor

from torch_radbp.jit.lane.emit import emit
from torch_radbp.jit.lane.graph import Program
from torch_radbp.jit.lane.lowered import without_library
from torch_radbp.jit.nvidia.driver import NoDriver, driver_of
from torch_radbp.jit.nvidia.graphs import MOST_LANES, SequenceMemory
from torch_radbp.jit.nvidia.launches import Caster, Part, RayQuery
from torch_radbp.jit.nvidia.nvptx import BLOCK, kernel_module
from torch_radbp.jit.nvidia.nvptx_lanes import COPIES, SMALL, put_text, scatter_text
from torch_radbp.jit.nvidia.recorded_launches import RecordedLaunches
from torch_radbp.jit.recording.addition import MOST_TABLES, SCALARS, Addition
from torch_radbp.jit.recording.any_device import AnyDevice
from torch_radbp.jit.recording.recording import NotRecordable, Recording, recording
from torch_radbp.threads.later import Later
from torch_radbp.threads.made_once import made_once

SCATTERED = {(dtype, tables): (dtype, tables) for dtype in SCALARS for tables in range(1, MOST_TABLES + 1)}


Start = Callable[[Any, int, int, int, int], None]  # as `Launcher.launch`, but of an address and a number of words


class Launcher(Protocol):
    """Loads and launches kernels: the driver of a device (`driver.py`), or a stand-in for tests."""

    architecture: str

    def load(self, text: str, name: str) -> Any:
        """Loads the kernel `name` of a module in LLVM IR."""

    def launch(self, kernel: Any, blocks: int, threads: int, parameters: array) -> None:
        """Launches a kernel.

        Args:
            kernel: from `load`.
            blocks, threads: how many blocks, of how many threads each.
            parameters: 64-bit words; read before this returns.
        """

    def together(self) -> AbstractContextManager[Start]:
        """A context with a function that starts several kernels, one after the other."""

    def stream(self) -> int:
        """The number of torch's current stream."""

    def is_captured(self) -> bool:
        """True while somebody else makes a graph of what is launched."""

    def captured(self, start: Callable[[Start], None]) -> Any:
        """The kernels that `start` launches, by the function that it is given or a ray caster, as a CUDA graph; None: there
        are no graphs."""

    def play(self, graph: Any) -> None:
        """Starts the kernels of a graph, one after the other."""


class LoadedKernel:
    """A kernel that is loaded on a device by a helper thread: assemblers need most of the time of a first call.

    Args:
        launcher: of the device.
        text: its module.
        name: its name.
    """

    def __init__(self, launcher: Launcher, text: str, name: str):
        self.launcher, self.loading = launcher, Later(partial(launcher.load, text, name)).beside()

    @cached_property
    def kernel(self) -> Any:
        """The kernel; waits until it is loaded."""
        return self.loading.result()

    def __call__(self, lanes: int, words: Sequence[int]) -> None:
        """Starts the kernel for all lanes, at least 1, and does not wait for it; `words`: its other parameters."""
        self.launcher.launch(self.kernel, -(-lanes // BLOCK), BLOCK, array("q", [lanes, 0, 0, *words]))


class KernelLoop:
    """A program as a kernel on the GPU, to be run for all lanes."""

    def __init__(self, kernel: LoadedKernel, searched: Sequence[int]):
        self.kernel, self.searched = kernel, searched

    def run(self, lanes: int, inputs: Sequence[int], lengths: Sequence[int], outputs: Sequence[int]) -> None:
        """Launches the kernel for all lanes, without waiting."""
        self.kernel(lanes, [*inputs, *[lengths[number] for number in self.searched], *outputs])


class Gpu(AnyDevice):
    """An NVIDIA GPU as a target: functions of lanes are compiled for it, and lanes moved about on it.

    Args:
        launcher: of the device.
    """

    counts_stay = loads_ahead = repeats = True

    def __init__(self, launcher: Launcher):
        super().__init__()
        self.launcher = launcher
        self.kernels: dict[tuple, LoadedKernel] = {}  # of `put` and `scatter_add`, by name and dtypes
        self.loading = Lock()
        self.memory = SequenceMemory()

    def text(self, program: Program) -> str:
        """The LLVM IR of a program's kernel."""
        return kernel_module(emit(without_library(program), width=1))

    @property
    def platform(self) -> str:
        """All that code depends on beside the program: nothing of the GPU, as it is LLVM IR that the driver compiles."""
        return "NVIDIA"

    def code(self, program: Program) -> bytes:
        """The LLVM IR of a program's kernel, as bytes."""
        return self.text(program).encode()

    def loop(self, code: bytes, searched: Sequence[int], keep: Callable[[bytes], None] | None = None) -> KernelLoop:
        """Loads a kernel as a loop."""
        return KernelLoop(LoadedKernel(self.launcher, code.decode(), "lanes"), searched)

    def compile(self, program: Program) -> KernelLoop:
        """Compiles and loads the kernel of a program."""
        return self.loop(self.code(program), program.searched)

    def kernel(self, name: str, case: tuple, text: Callable[[tuple], str]) -> LoadedKernel:
        """A kernel for tensors of some dtypes, loaded once."""
        key = (name, *case)
        if key not in self.kernels:
            with self.loading:
                if key not in self.kernels:
                    self.kernels[key] = LoadedKernel(self.launcher, text(case), name)
        return self.kernels[key]

    def recorded(self, recording: Recording, given: Sequence[Tensor | int], results: Any) -> RecordedLaunches:
        """Prepares a recording to be played as launches of kernels; args as of `RecordedResults`."""
        return RecordedLaunches(self, recording, given, results)

    def comes_again(self, lanes: int) -> bool:
        """True if sequences of launches over so many lanes may have graphs."""
        return lanes <= MOST_LANES and not self.launcher.is_captured()

    def launch_all(self, part: Part, words: Tensor, lanes: int, caster: Caster | None, comes_again: bool) -> None:
        """Starts kernels, one after the other, and waits for none.

        Args:
            part: the launches.
            words: theirs, int64 on the CPU.
            lanes: as many as there may be.
            caster: of rays.
            comes_again: it may have a graph.
        """
        address = words.data_ptr() - 8 * part.words.start

        def start(launch: Start) -> None:
            for kernel, blocks, first, last in part.launches:
                if isinstance(kernel, RayQuery):
                    caster.launch(kernel.kernel, lanes, *(ctypes.c_int64 * (last - first)).from_address(address + 8 * first))
                else:
                    launch(kernel.kernel, blocks, BLOCK, address + 8 * first, last - first)

        if comes_again:
            given = ctypes.string_at(words.data_ptr(), words.nbytes) + (caster.given() if part.casts else b"")
            graph = part.graphs.of(given, partial(self.launcher.captured, start))
            if graph is not None:
                return self.launcher.play(graph)
        with self.launcher.together() as launch:
            start(launch)

    def room(self, size: int, device: torch.device, comes_again: bool) -> Tensor:
        """Bytes that a sequence of launches works in, which may have a graph."""
        if comes_again and size:
            return self.memory.room(size, self.launcher.stream(), device)
        return torch.empty(size, dtype=torch.uint8, device=device)

    def put(self, targets: Sequence[Tensor], place: Tensor, entries: Sequence[Tensor]) -> None:
        words = [place.data_ptr()]
        for target, entry in zip(targets, entries):
            words += (entry.data_ptr(), target.data_ptr())
        self.kernel("put", tuple(target.dtype for target in targets), put_text)(place.numel(), words)

    def copies(self, entries: int) -> int:
        return COPIES if entries <= SMALL else 1

    def scatter_add(self, additions: Sequence[Addition], lanes: int) -> None:
        """Scatter-adds numbers of lanes to tables, by atomic additions of float64; if torch is told to be deterministic, it
        sorts and sums them."""
        if (listener := recording()) is not None:
            if torch.are_deterministic_algorithms_enabled():
                raise NotRecordable("torch sums what it has sorted")
            listener.scatter_add([additions], lanes, SCATTERED)
            return
        if torch.are_deterministic_algorithms_enabled():
            return super().scatter_add(additions, lanes)
        words: list[int] = []
        for index, numbers, sums in additions:
            words += (index.data_ptr(), *sums.words)
            for number, address in zip(numbers, sums.addresses):
                words += (number.data_ptr(), address)
        case = tuple((addition.numbers[0].dtype, len(addition.numbers)) for addition in additions)
        self.kernel("scatter", case, scatter_text)(lanes, words)


@made_once
def gpu_of(device: torch.device) -> AnyDevice:
    """The target of a CUDA device; without a driver one that compiles nothing, and says why when it should."""
    try:
        return Gpu(driver_of(device))
    except NoDriver as reason:
        return AnyDevice(str(reason))
