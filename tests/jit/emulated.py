"""A stand-in for a GPU: kernels run on the processor, one thread after another, from the very text that PTX is made of.

What differs from the GPU's is the target that LLVM compiles for, and that a thread is told by arguments where it is.
"""

from __future__ import annotations

import contextlib
import ctypes
import re
import threading
from array import array
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, NamedTuple

from torch_radbp.jit.cpu.machine import cached_code
from torch_radbp.jit.nvidia.gpu import Gpu
from torch_radbp.jit.nvidia.nvptx import ptx

LAUNCH = """\
define void @launch(i64 %blocks, i64 %threads, ptr %words) {{
entry:
{loads}
  %all = mul i64 %blocks, %threads
  %last = sub i64 %all, 1
  br label %turn
turn:
  %k = phi i64 [ 0, %entry ], [ %next, %turn ]
  %from_end = sub i64 %last, %k
  %wide_block = udiv i64 {thread}, %threads
  %wide_thread = urem i64 {thread}, %threads
  %block = trunc i64 %wide_block to i32
  %thread = trunc i64 %wide_thread to i32
  call void @{name}(i32 %block, i32 %thread, {arguments})
  %next = add i64 %k, 1
  %more = icmp slt i64 %next, %all
  br i1 %more, label %turn, label %done
done:
  ret void
}}"""
SIGNATURE = r"define ptx_kernel void @(\w+)\((.*?)\) #0"


def on_processor(text: str, backwards: bool = False) -> str:
    """The module of a kernel, with a function `launch` that runs all threads, for the processor."""
    name, parameters = re.search(SIGNATURE, text).groups()
    kinds = [parameter.split()[0] for parameter in parameters.split(", ")]
    loads = "\n".join(f"  %at{k} = getelementptr i64, ptr %words, i64 {k}\n  %word{k} = load {kind}, ptr %at{k}, align 8"
                      for k, kind in enumerate(kinds))
    text = re.sub(r"(?m)^(target triple|declare i32 @llvm.nvvm|attributes #0|.* = call i32 @llvm.nvvm).*\n", "", text)
    text = text.replace(f"define ptx_kernel void @{name}(", f"define internal void @{name}(i32 %block, i32 %thread, ")
    text = text.replace(") #0 {", ") {").replace(' syncscope("device")', "")
    arguments = ", ".join(f"{kind} %word{k}" for k, kind in enumerate(kinds))
    return "\n".join([text, LAUNCH.format(loads=loads, name=name, arguments=arguments,
                                          thread="%from_end" if backwards else "%k")])


class Launch(NamedTuple):
    """What a kernel was started with."""

    name: str
    blocks: int
    threads: int
    words: list[int]


class Emulated:
    """A launcher of `Gpu` whose device is the processor.

    Args:
        assemble: also makes PTX of each kernel, as for a GPU.
        backwards: the last thread comes first; a GPU's come in any order.
        makes_graphs: of sequences of launches that come again.
    """

    architecture = "sm_90"

    def __init__(self, assemble: bool = False, backwards: bool = False, makes_graphs: bool = True):
        self.assemble, self.backwards, self.makes_graphs = assemble, backwards, makes_graphs
        self.ptx: list[str] = []
        self.launches: list[Launch] = []
        self.sequences = self.replays = 0  # of several launches; those that are started as graphs
        self.calls = 0  # of the driver, apart from those that load kernels or make graphs
        self.of_thread = threading.local()

    @property
    def graph(self) -> list[Callable[[], None]] | None:
        """What is being captured in this thread; None: nothing, what is launched runs."""
        return getattr(self.of_thread, "graph", None)

    def load(self, text: str, name: str) -> Any:
        if self.assemble:
            self.ptx.append(ptx(text, self.architecture))
        return name, cached_code(on_processor(text, self.backwards), "launch", optimized=False)

    @contextlib.contextmanager
    def together(self) -> Iterator[Callable[[Any, int, int, int, int], None]]:
        self.sequences += 1
        self.calls += 2  # the context comes and goes

        def launch(kernel: Any, blocks: int, threads: int, address: int, count: int) -> None:
            self.start(kernel, blocks, threads, array("q", ctypes.string_at(address, 8 * count)))

        yield launch

    def launch(self, kernel: Any, blocks: int, threads: int, parameters: array) -> None:
        self.calls += 2
        self.start(kernel, blocks, threads, parameters)

    def start(self, kernel: Any, blocks: int, threads: int, parameters: array) -> None:
        """Runs a kernel, or captures it."""
        self.started(partial(self.run, kernel, blocks, threads, parameters))

    def started(self, run: Callable[[], None]) -> None:
        """Runs what a call of the driver starts, or captures it; of other libraries, too."""
        if self.graph is not None:
            self.graph.append(run)
            return
        self.calls += 1
        run()

    def run(self, kernel: Any, blocks: int, threads: int, parameters: array) -> None:
        name, code = kernel
        self.launches.append(Launch(name, blocks, threads, parameters.tolist()))
        words = ctypes.c_void_p(parameters.buffer_info()[0])
        ctypes.CFUNCTYPE(None, ctypes.c_int64, ctypes.c_int64, ctypes.c_void_p)(code.address)(blocks, threads, words)

    def stream(self) -> int:
        return 0

    def is_captured(self) -> bool:
        self.calls += 1
        return False

    def captured(self, start: Callable[[Callable], None]) -> list[Callable[[], None]] | None:
        if not self.makes_graphs:
            return None
        self.of_thread.graph = []
        try:
            start(lambda kernel, blocks, threads, address, count: self.start(
                kernel, blocks, threads, array("q", ctypes.string_at(address, 8 * count))))
            return self.graph
        finally:
            self.of_thread.graph = None

    def play(self, graph: list[Callable[[], None]]) -> None:
        self.sequences += 1
        self.replays += 1
        self.calls += 3  # with the context
        for run in graph:
            run()


def emulated() -> Gpu:
    """A GPU in name, whose tensors lie on the processor."""
    return Gpu(Emulated())
