"""Loads and launches kernels on an NVIDIA GPU, by CUDA's driver, on torch's current stream.

Machine code is made of PTX by the driver's own assembler, which takes seconds for the longest kernels; so it is kept on disk
(`store/code_cache.py`). `tests/jit/test_driver.py` holds what is asked of the driver.

Reference: NVIDIA, CUDA Driver API.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import tempfile
import weakref
from array import array
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from threading import Lock
from typing import Any

import torch

from torch_radbp.install_hint import install_with
from torch_radbp.jit.nvidia.nvptx import ptx
from torch_radbp.jit.store import code_cache
from torch_radbp.threads.later import Later

# CU_LAUNCH_PARAM_BUFFER_POINTER, _BUFFER_SIZE and _END: a launch hands over its parameters as one piece of memory.
BUFFER, SIZE, END = 1, 2, 0
WORDS = 8192  # bytes of what the assembler says at most
NON_BLOCKING = 1  # CU_STREAM_NON_BLOCKING: other streams may be used while this one is captured


class Graph:
    """A CUDA graph, ready to be launched; the driver frees it with this object, once launches that have begun are done.

    Args:
        driver: the module.
        handle: the driver's.
    """

    def __init__(self, driver: Any, handle: Any):
        self.handle = handle
        weakref.finalize(self, driver.cuGraphExecDestroy, handle).atexit = False


class Driver:
    """CUDA's driver for one device, which loads and launches kernels and graphs of them.

    Args:
        driver: the module `cuda.bindings.driver`.
        architecture: of the device, such as "sm_90".
        device: torch's.
        stream: tells the number of the stream that is current on it.
        on: a context in which the stream of a number is the current one.
    """

    def __init__(self, driver: Any, architecture: str, device: torch.device, stream: Callable[[], int],
                 on: Callable[[int], AbstractContextManager]):
        self.driver, self.architecture, self.device, self.stream, self.on = driver, architecture, device, stream, on
        self.context = self.ask(driver.cuDevicePrimaryCtxRetain, self.ask(driver.cuDeviceGet, device.index or 0))
        self.aside: Any = None  # the stream on which graphs are captured; nothing runs there
        self.one = Lock()  # graphs are made and started by one thread at a time

    def ask(self, function: Callable, *arguments) -> Any:
        """Calls a function of the driver, and returns its result.

        Raises:
            RuntimeError: with the driver's words, if it reports an error.
        """
        error, *answers = function(*arguments)
        if error != self.driver.CUresult.CUDA_SUCCESS:
            _, name = self.driver.cuGetErrorName(error)
            _, words = self.driver.cuGetErrorString(error)
            raise RuntimeError(f"{function.__name__} on {self.device}: {name.decode()}, {words.decode()}")
        return answers[0] if len(answers) == 1 else answers

    @contextlib.contextmanager
    def current(self) -> Iterator[None]:
        """A context in which this device is the driver's current one."""
        self.ask(self.driver.cuCtxPushCurrent, self.context)
        try:
            yield
        finally:
            self.ask(self.driver.cuCtxPopCurrent)

    def load(self, text: str, name: str) -> Any:
        """Loads the kernel `name` of a module in LLVM IR."""
        with self.current():
            code = code_cache.machine_code(text, self.architecture, self.assembled)
            module = self.ask(self.driver.cuModuleLoadData, code)  # stays until the process ends
            return self.ask(self.driver.cuModuleGetFunction, module, name.encode())

    def assembled(self, text: str) -> bytes:
        """Compiles a module to machine code, by the driver's assembler."""
        with Later.helping:
            code = ptx(text, self.architecture).encode() + b"\0"
        driver = self.driver
        complaint = bytes(WORDS)  # the bindings take the address of bytes, and the assembler writes there
        option = driver.CUjit_option
        state = self.ask(driver.cuLinkCreate, 2, [option.CU_JIT_ERROR_LOG_BUFFER, option.CU_JIT_ERROR_LOG_BUFFER_SIZE_BYTES],
                         [complaint, WORDS])
        try:
            kind = driver.CUjitInputType.CU_JIT_INPUT_PTX
            self.ask(driver.cuLinkAddData, state, kind, code, len(code), b"lanes", 0, [], [])
            address, size = self.ask(driver.cuLinkComplete, state)
            return ctypes.string_at(int(address), size)
        except RuntimeError as error:
            raise RuntimeError(f"{error}. {refused(code, complaint)}") from error
        finally:
            self.ask(driver.cuLinkDestroy, state)

    def launch(self, kernel: Any, blocks: int, threads: int, parameters: array) -> None:
        """Starts a kernel on torch's current stream; `parameters` are copied before this returns."""
        with self.together() as launch:
            launch(kernel, blocks, threads, *parameters.buffer_info())

    @contextlib.contextmanager
    def together(self) -> Iterator[Callable[[Any, int, int, int, int], None]]:
        """A context with a function that starts kernels, one after the other, on torch's current stream."""
        size, stream = ctypes.c_size_t(), self.stream()
        words = (ctypes.c_void_p * 5)(BUFFER, 0, SIZE, ctypes.addressof(size), END)
        extra = ctypes.addressof(words)

        def launch(kernel: Any, blocks: int, threads: int, address: int, count: int) -> None:
            words[1], size.value = address, 8 * count
            self.ask(self.driver.cuLaunchKernel, kernel, blocks, 1, 1, threads, 1, 1, 0, stream, 0, extra)

        with self.current():
            yield launch

    def is_captured(self) -> bool:
        """True while the caller makes a graph of what is launched on torch's current stream."""
        return self.ask(self.driver.cuStreamIsCapturing, self.stream()) != 0

    def captured(self, start: Callable[[Callable], None]) -> Graph | None:
        """The kernels that `start` launches as a CUDA graph; None: the driver makes none, for lack of memory or by age.

        It is captured on a stream of its own, since torch's usual one cannot be.
        """
        driver = self.driver
        try:
            with self.one, self.current():
                if self.aside is None:
                    self.aside = self.ask(driver.cuStreamCreate, NON_BLOCKING)
                # Relaxed, as memory may be freed meanwhile, by whatever Python collects.
                self.ask(driver.cuStreamBeginCapture, self.aside, driver.CUstreamCaptureMode.CU_STREAM_CAPTURE_MODE_RELAXED)
                try:
                    with self.on(int(self.aside)), self.together() as launch:
                        start(launch)
                finally:
                    graph = self.ask(driver.cuStreamEndCapture, self.aside)
                try:
                    return Graph(driver, self.ask(driver.cuGraphInstantiate, graph, 0))
                finally:
                    self.ask(driver.cuGraphDestroy, graph)
        except RuntimeError:
            return None

    def play(self, graph: Graph) -> None:
        """Starts the kernels of a graph on torch's current stream."""
        with self.one, self.current():
            self.ask(self.driver.cuGraphLaunch, graph.handle, self.stream())


def refused(code: bytes, complaint: bytes) -> str:
    """The assembler's error about PTX, and the file in which the PTX was saved."""
    said = complaint.partition(b"\0")[0].decode(errors="replace").strip() or "nothing"
    handle, name = tempfile.mkstemp(prefix="torch_radbp-", suffix=".ptx")
    with os.fdopen(handle, "wb") as file:
        file.write(code.rstrip(b"\0"))
    return f"The assembler said: {said}. Its input is {name}"


class NoDriver(RuntimeError):
    """Error: kernels cannot be launched; the message says what is missing, and what to do."""


def driver_of(device: torch.device) -> Driver:
    """CUDA's driver for one of torch's devices.

    Raises:
        NoDriver: if `cuda-bindings` is not installed, or finds no driver.
    """
    try:
        from cuda.bindings import driver
    except ImportError as error:
        raise NoDriver("compiled rendering on CUDA launches its kernels by NVIDIA's `cuda-bindings`, which is not "
                       f"installed: {install_with('cuda')}, or render with compile=False") from error
    try:
        error, = driver.cuInit(0)
    except Exception as missing:  # the bindings have an error of their own for it, by version
        raise NoDriver(f"compiled rendering on CUDA needs NVIDIA's display driver, which was not found: {missing}. "
                           "Install it, or render with compile=False") from missing
    if error != driver.CUresult.CUDA_SUCCESS:
        raise NoDriver(f"NVIDIA's display driver could not be started: {error.name}. Look at what nvidia-smi says, or "
                           "render with compile=False")
    major, minor = torch.cuda.get_device_capability(device)
    return Driver(driver, f"sm_{major}{minor}", device, lambda: torch.cuda.current_stream(device).cuda_stream,
                  lambda stream: torch.cuda.stream(torch.cuda.ExternalStream(stream, device)))
