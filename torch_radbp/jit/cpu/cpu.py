"""The CPU as a target: a loop over blocks of vectors, on as many threads as torch has.

    void lanes(i64 first, i64 last, ptr inputs, ptr outputs)

computes the lanes from `first` to `last` in blocks of W. If the last block is not full, it is moved back so that it ends at
`last`; lanes that are computed twice get the same results twice. Fewer than W lanes are computed in copies that are a full
block. `inputs` and `outputs` are arrays of pointers; behind those of the inputs stand their lengths. `lanes_of_job` calls it
for parts of a `team.Job` until none is left, and may run on several threads at once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import torch
from torch import Tensor

from torch_radbp.jit.cpu import cpu_order, cpu_patches, cpu_runs, cpu_scatter
from torch_radbp.jit.cpu.kernel_code import CpuLoop, KernelCode
from torch_radbp.jit.cpu.machine import host, host_features, host_width
from torch_radbp.jit.cpu.prefetch import DECLARATION, prefetches
from torch_radbp.jit.cpu.recorded import Recorded
from torch_radbp.jit.lane.emit import Body, emit
from torch_radbp.jit.lane.fused import fuses
from torch_radbp.jit.lane.graph import LANES, Program
from torch_radbp.jit.lane.instructions import alignment
from torch_radbp.jit.lane.loops import TAKE_PARTS, few_lanes
from torch_radbp.jit.lane.window import window_of
from torch_radbp.jit.recording.recording import Recording

COPIES, SMALL = 4, 1 << 12  # copies of the totals of `jit/scatter.py`, for tables with at most so many entries


class Cpu:
    """The CPU of this machine as a target.

    Args:
        width: lanes in a block; None: those of a vector of the processor, of float64 if there are results of that. A search
            waits for one entry after the other, and two vectors wait together: programs take two where they search.
    """

    counts_stay = loads_ahead = repeats = False

    def __init__(self, width: int | None = None):
        self.width = width

    def text(self, program: Program) -> str:
        """The LLVM IR of a program."""
        width = self.width or block_width(program)
        return loop_module(emit(program, width, window_of(host_features()), fuses(host_features())), width)

    @property
    def platform(self) -> str:
        """The processor with its instruction sets, on which compiled code depends; a key of caches."""
        return f"{host()}, {self.width or host_width()} lanes"

    def code(self, program: Program) -> bytes:
        """Compiles a program to machine code, packed with what better code is made of; quickly for a small rendering."""
        return KernelCode.first(self.text(program)).packed()

    def loop(self, code: bytes, searched: Sequence[int] = (), keep: Callable[[bytes], None] | None = None) -> CpuLoop:
        """Loads machine code, from `code`, as a loop over lanes; other args as of `Target.loop`."""
        return CpuLoop(code, keep)

    def compile(self, program: Program) -> CpuLoop:
        """Compiles a program with all of LLVM's optimisations, and loads it."""
        return self.loop(KernelCode.made(self.text(program), well=True).packed())

    def recorded(self, recording: Recording, given: Sequence[Tensor | int], results: Any) -> Recorded:
        """Compiles a recording to machine code of this processor; args as of `RecordedResults`."""
        return Recorded(recording, given, results)

    chosen = staticmethod(cpu_order.chosen_on_cpu)
    partition = staticmethod(cpu_order.partition_on_cpu)
    in_order = staticmethod(cpu_runs.in_order_on_cpu)
    inverted = staticmethod(cpu_order.inverted_on_cpu)
    nothing = staticmethod(cpu_order.nothing_on_cpu)
    put = staticmethod(cpu_order.put_on_cpu)
    scatter_add = staticmethod(cpu_scatter.scatter_add_on_cpu)
    add_patches = staticmethod(cpu_patches.add_patches_on_cpu)

    def copies(self, entries: int) -> int:
        """The number of copies in which a table of gradients is summed: several if it is small, one if it is large."""
        return COPIES if entries <= SMALL else 1


def loop_module(body: Body, width: int) -> str:
    """The LLVM IR of a loop that runs `body` for blocks of `width` lanes."""
    outputs = [value for value in body.program.outputs if value is not None]
    hints = prefetches(body.program, body.names, width) if width > 1 else ()
    sizes = ([alignment(value.dtype) if value.kind == LANES else 0 for value in body.program.inputs],
             [alignment(value.dtype) for value in outputs])
    return "\n".join([
        TAKE_PARTS.format(width=width), few_lanes(*sizes, width),
        "define internal void @lanes(i64 %first, i64 %last, ptr noalias %inputs, ptr noalias %outputs) {", "entry:",
        *indented([*pointers(body.program, len(outputs)), *body.before]), f"  %final = sub i64 %last, {width}",
        "  br label %loop", "loop:", "  %at = phi i64 [ %first, %entry ], [ %next, %turn ]",
        "  %over = icmp sgt i64 %at, %final", "  %i = select i1 %over, i64 %final, i64 %at",
        *indented(body.block), "  br label %turn", "turn:", *indented(hints),
        f"  %next = add i64 %at, {width}", "  %more = icmp slt i64 %next, %last",
        "  br i1 %more, label %loop, label %done", "done:", "  ret void", "}", *body.functions,
        *([DECLARATION] if width > 1 else []), ""])


def block_width(program: Program) -> int:
    """The number of lanes that a pass of a program's loop computes: those of one vector, or of two where it searches."""
    in_double = any(value is not None and value.dtype == torch.float64 for value in program.outputs)
    # LLVM splits every instruction for more lanes than a vector has, and takes half as long again.
    return host_width() // (2 if in_double else 1) * (2 if program.searched else 1)


def pointers(program: Program, outputs: int) -> Iterator[str]:
    """Instructions that load the pointers in the arrays `%inputs` and `%outputs`."""
    inputs = len(program.inputs)
    for number in range(inputs):
        yield from (f"%place{number} = getelementptr ptr, ptr %inputs, i64 {number}",
                    f"%in{number} = load ptr, ptr %place{number}, align 8")
    for number in program.searched:
        yield from (f"%length_at{number} = getelementptr i64, ptr %inputs, i64 {inputs + number}",
                    f"%length{number} = load i64, ptr %length_at{number}, align 8")
    for number in range(outputs):
        yield from (f"%result{number} = getelementptr ptr, ptr %outputs, i64 {number}",
                    f"%out{number} = load ptr, ptr %result{number}, align 8")


def indented(lines: Sequence[str]) -> Iterator[str]:
    return (f"  {line}" for line in lines)
