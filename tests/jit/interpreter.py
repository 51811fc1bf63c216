"""A stand-in for CUDA's driver, whose device is an interpreter of PTX, if one is given; it checks every access to memory.

`RADBP_PTX_INTERPRETER` names the folder of the interpreter; without it, it is looked for beside the repository. Its module
`ptxrun` has

    kernel = Kernel(text)                     PTX with one .entry, whose instructions it all knows, or it raises
    kernel.launch(blocks, threads, words)     of each parameter a number, or a `Memory`; runs all threads
    Memory(address, bytes, readable, writable, name)

`launch` raises if a thread leaves the memory that it is given, reads or writes what it must not, or an address is no
multiple of the size of what lies there. Registers hold rubbish before they are written.
"""

from __future__ import annotations

import contextlib
import ctypes
import importlib.util
import os
import shutil
import threading
from array import array
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest
import torch
from torch import Tensor

from torch_radbp.jit.lane.graph import LANES, NUMBER, TABLE, Program, Value
from torch_radbp.jit.lane.instructions import alignment
from torch_radbp.jit.nvidia.driver import BUFFER, END, SIZE, Driver
from torch_radbp.jit.nvidia.gpu import Gpu, KernelLoop
from torch_radbp.jit.recording.addition import Addition
from torch_radbp.threads.made_once import made_once

BESIDE = Path(__file__).parents[3] / "shared" / "tools" / "ptx"
MODULE = Path(os.environ.get("RADBP_PTX_INTERPRETER") or BESIDE, "ptxrun.py")
ASIDE = 5  # the stream that graphs are captured on

needs_interpreter = pytest.mark.skipif(
    not MODULE.is_file() or shutil.which("cc") is None,
    reason="no interpreter of PTX: RADBP_PTX_INTERPRETER names the folder of one, which may need a C compiler, `cc`")


@made_once
def interpreter() -> ModuleType:
    """The interpreter's module."""
    given = importlib.util.spec_from_file_location("ptxrun", MODULE)
    module = importlib.util.module_from_spec(given)
    given.loader.exec_module(module)
    return module


class Allowed(threading.local):
    """Memory that the next launch of this thread may touch, by address; None: any."""

    def __init__(self) -> None:
        self.memory: dict[int, Any] | None = None

    @contextlib.contextmanager
    def only(self, memory: Sequence) -> Iterator[None]:
        """Inside, launches are given these pieces of memory; of those at one address the largest."""
        pieces = sorted((piece for piece in memory if piece.size), key=lambda piece: piece.size)
        self.memory = {piece.address: piece for piece in pieces}
        try:
            yield
        finally:
            self.memory = None

    def words(self, parameters: Sequence[int]) -> list:
        """The parameters of a launch, with memory in the place of its address."""
        return list(parameters) if self.memory is None else [self.memory.get(word, word) for word in parameters]


ALLOWED = Allowed()


class StandInDriver:
    """Stands for `cuda.bindings.driver`: a module's machine code is its PTX, which the interpreter runs.

    Attributes:
        launches: names of the kernels, with how often each was launched.
        texts: PTX of all modules.
        replays: how many graphs were launched.
    """

    CUresult = SimpleNamespace(CUDA_SUCCESS=0)
    CUstreamCaptureMode = SimpleNamespace(CU_STREAM_CAPTURE_MODE_RELAXED="relaxed")
    CUjitInputType = SimpleNamespace(CU_JIT_INPUT_PTX="ptx")
    CUjit_option = SimpleNamespace(CU_JIT_ERROR_LOG_BUFFER="log", CU_JIT_ERROR_LOG_BUFFER_SIZE_BYTES="size")

    def __init__(self) -> None:
        self.launches: Counter[str] = Counter()
        self.texts: list[str] = []
        self.replays = 0
        self.one = threading.Lock()  # kernels run one after another
        self.of_thread = threading.local()

    @property
    def contexts(self) -> list:
        """Those that are current in this thread, the last on top."""
        return self.of_thread.__dict__.setdefault("contexts", [])

    @property
    def captures(self) -> dict[int, list[Callable[[], None]]]:
        """What this thread has started on streams that it captures."""
        return self.of_thread.__dict__.setdefault("captures", {})

    def cuDeviceGet(self, number: int) -> tuple:
        return 0, number

    def cuDevicePrimaryCtxRetain(self, device: int) -> tuple:
        return 0, f"context of {device}"

    def cuCtxPushCurrent(self, context: str) -> tuple:
        self.contexts.append(context)
        return 0,

    def cuCtxPopCurrent(self) -> tuple:
        return 0, self.contexts.pop()

    def cuLinkCreate(self, *options) -> tuple:
        return 0, []

    def cuLinkAddData(self, state: list, kind: str, code: bytes, size: int, *rest) -> tuple:
        assert kind == "ptx" and size == len(code) and code.endswith(b"\0")
        state.append(ctypes.create_string_buffer(code[:-1], size - 1))
        return 0,

    def cuLinkComplete(self, state: list) -> tuple:
        return 0, ctypes.addressof(state[0]), len(state[0])

    def cuLinkDestroy(self, state: list) -> tuple:
        return 0,

    def cuModuleLoadData(self, code: bytes) -> tuple:
        text = code.decode().replace('.pragma "nounroll";', "")  # a hint to the assembler
        self.texts.append(text)  # by several threads
        return 0, interpreter().Kernel(text)

    def cuModuleGetFunction(self, module: Any, name: bytes) -> tuple:
        assert module.name.encode() == name
        return 0, module

    def cuStreamCreate(self, flags: int) -> tuple:
        assert flags == 1  # else the usual stream could not be used meanwhile
        return 0, ASIDE

    def cuStreamIsCapturing(self, stream: int) -> tuple:
        return 0, int(stream in self.captures)

    def cuStreamBeginCapture(self, stream: int, mode: str) -> tuple:
        assert self.contexts and stream and stream not in self.captures and mode == "relaxed"
        self.captures[stream] = []
        return 0,

    def cuStreamEndCapture(self, stream: int) -> tuple:
        return 0, self.captures.pop(stream)

    def cuGraphInstantiate(self, graph: list, flags: int) -> tuple:
        return 0, tuple(graph)

    def cuGraphDestroy(self, graph: list) -> tuple:
        graph.clear()
        return 0,

    def cuGraphExecDestroy(self, graph: tuple) -> tuple:
        return 0,

    def cuGraphLaunch(self, graph: tuple, stream: int) -> tuple:
        assert self.contexts and stream not in self.captures
        self.replays += 1
        for run in graph:
            run()
        return 0,

    def started(self, run: Callable[[], None]) -> None:
        """Runs what is started on the stream that is current, or captures it."""
        if ASIDE in self.captures:
            self.captures[ASIDE].append(run)
        else:
            run()

    def cuLaunchKernel(self, kernel: Any, *given) -> tuple:
        blocks, one, flat, threads, *rest, extra = given
        assert self.contexts and (one, flat, *rest[:3], rest[-1]) == (1, 1, 1, 1, 0, 0)
        assert (rest[3] == ASIDE) == bool(self.captures)
        words = (ctypes.c_void_p * 5).from_address(extra)
        assert (words[0], words[2], words[4] or 0) == (BUFFER, SIZE, END)
        parameters = array("q", ctypes.string_at(words[1], ctypes.c_size_t.from_address(words[3]).value))
        self.started(partial(self.run, kernel, blocks, threads, ALLOWED.words(parameters)))
        return 0,

    def run(self, kernel: Any, blocks: int, threads: int, words: list) -> None:
        """Runs a kernel."""
        with self.one:
            self.launches[kernel.name] += 1
            kernel.launch(blocks, threads, words)


class CheckedLoop:
    """The kernel of a program, which may read its inputs and write its outputs; see `target.Loop`."""

    def __init__(self, loop: KernelLoop, program: Program):
        self.loop, self.program = loop, program

    def run(self, lanes: int, inputs: Sequence[int], lengths: Sequence[int], outputs: Sequence[int]) -> None:
        """Runs all lanes."""
        piece = interpreter().Memory
        sizes = [alignment(value.dtype) * entries(self.program, value, lanes, length)
                 for value, length in zip(self.program.inputs, lengths)]
        read = [piece(address, size, True, False, repr(value))
                for value, address, size in zip(self.program.inputs, inputs, sizes)]
        written = [piece(address, alignment(value.dtype) * lanes, False, True, f"output {value!r}")
                   for value, address in zip(self.program.outputs, outputs)]
        with ALLOWED.only([*read, *written]):
            self.loop.run(lanes, inputs, lengths, outputs)


def entries(program: Program, value: Value, lanes: int, length: int) -> int:
    """How many entries an input spans; `length`: of a table, which may be a column of rows."""
    column = program.column(value)
    return {LANES: lanes, NUMBER: 1, TABLE: length if column is None else (length - 1) * column.width + 1}[value.kind]


def piece_of(tensor: Tensor, readable: bool, writable: bool) -> Any:
    """The memory of a tensor, from its first entry to its last; of a column of rows with what lies between."""
    entries = 1 + sum((size - 1) * stride for size, stride in zip(tensor.shape, tensor.stride())) if tensor.numel() else 0
    return interpreter().Memory(tensor.data_ptr(), entries * tensor.itemsize, readable, writable, str(tensor.shape))


class CheckedGpu(Gpu):
    """A GPU whose kernels may touch the tensors that they are for."""

    def compile(self, program: Program) -> CheckedLoop:
        return CheckedLoop(super().compile(program), program)

    def put(self, targets: Sequence[Tensor], place: Tensor, entries: Sequence[Tensor]) -> None:
        with ALLOWED.only([*(piece_of(tensor, True, False) for tensor in (place, *entries)),
                           *(piece_of(tensor, False, True) for tensor in targets)]):
            super().put(targets, place, entries)

    def scatter_add(self, additions: Sequence[Addition], lanes: int) -> None:
        read = [piece_of(tensor, True, False) for case in additions for tensor in (case.index, *case.numbers)]
        touched = [piece_of(case.sums.touched, False, True) for case in additions]
        totals = [piece_of(total, True, True) for case in additions for total in case.sums.totals]
        with ALLOWED.only([*read, *touched, *totals]):
            super().scatter_add(additions, lanes)


def interpreted(architecture: str = "sm_90") -> CheckedGpu:
    """A GPU in name, whose tensors lie on the processor and whose PTX is interpreted."""
    driver = StandInDriver()
    return CheckedGpu(Driver(driver, architecture, torch.device("cuda", 0), lambda: next(iter(driver.captures), 0),
                             lambda stream: contextlib.nullcontext()))
