"""How far the fused loops are from what the machine can do: ``python -m benchmarks.limits``.

One thread, in CPU seconds. For each function that a pass of a scene calls compiled: the seconds of its loops, and the least
time that their tensors of lanes, their arithmetic and their gathers take on this machine. Those limits are measured here, by
loops of the same compiler: one that copies tensors larger than the caches, one that multiplies and adds in registers, one
that reads a table of a few hundred entries at random. A loop overlaps them at best, so that it cannot be faster than the
greatest; where it does not overlap them it takes their sum. Divisions, square roots and conversions count like additions,
which they are slower than. Most tables do not fit into the nearest cache, so that gathers take longer than the limit says:
how long tells the same loop with every gather replaced by one vector that is always read from the same place.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import NamedTuple
from unittest.mock import patch

import torch

from benchmarks.peers import Ours
from benchmarks.scenes import QUICK, SCENES
from torch_radbp.jit import LaneFunction
from torch_radbp.jit.arguments import Arguments
from torch_radbp.jit.cpu.cpu import loop_module
from torch_radbp.jit.cpu.kernel_code import CpuLoop, KernelCode
from torch_radbp.jit.cpu.machine import host_width
from torch_radbp.jit.lane.emit import ProgramText
from torch_radbp.jit.lane.graph import LANES, Program, Value
from torch_radbp.jit.lane.instructions import memory
from torch_radbp.jit.run import Compiled
from torch_radbp.threads.later import Later

NO_WORK = ("input", "constant", "gather")
CHAINS, STEPS = 8, 64  # of the arithmetic that is measured: independent chains hide the latency of each operation
LARGE, SMALL, ENTRIES = 1 << 24, 1 << 13, 256


class Work(NamedTuple):
    """What a loop does for all its lanes."""

    moved: float = 0.0  # bytes of tensors of lanes, read and written
    operations: float = 0.0
    gathers: float = 0.0

    def plus(self, program: Program, lanes: int) -> Work:
        """With that of a call of a program."""
        of_lanes = [value for value in program.values if value.kind == LANES]
        tensors = [value for value in of_lanes if value.operation == "input"] + [
            value for value in program.outputs if value is not None]
        return Work(self.moved + lanes * sum(value.dtype.itemsize for value in tensors),
                    self.operations + lanes * sum(value.operation not in NO_WORK for value in of_lanes),
                    self.gathers + lanes * sum(value.operation == "gather" for value in of_lanes))


class Unread(ProgramText):
    """The text of a program that reads no tables at indices; searches stay."""

    def read(self, value: Value) -> str:
        return self.gather(value)

    def gather(self, value: Value) -> str:
        if not any(line.startswith("%unread") for line in self.entry):
            self.entry += ["%unread = alloca <16 x i64>, align 128",
                           "store <16 x i64> zeroinitializer, ptr %unread, align 128"]
        entries = self.line(f"load {self.vector(memory(value.dtype))}, ptr %unread, align 64")
        if value.dtype != torch.bool:
            return entries
        return self.line(f"trunc {self.vector('i8')} {entries} to {self.vector('i1')}")


def without_reads(program: Program) -> CpuLoop:
    """The loop of a program without its gathers."""
    text = loop_module(Unread(program, host_width()).instructions(), host_width())
    return CpuLoop(KernelCode.made(text, well=True).packed())


def copied(x):
    return x + 1.0


def computed(x):
    chains = [x + float(chain) for chain in range(CHAINS)]
    for _ in range(STEPS):
        chains = [chain * 0.999 + 0.001 for chain in chains]
    return sum(chains)


def read(table, index):
    total = table[index]
    for step in range(1, 16):
        total = total + table[(index + step * 7) & (ENTRIES - 1)]
    return total


def best_seconds(function: LaneFunction, *arguments) -> float:
    """The least time of a loop among several calls, into the same memory."""
    results = function(*arguments)
    times = []
    for _ in range(9):
        start = time.thread_time()
        function.into(results, 0, *arguments)
        times.append(time.thread_time() - start)
    return min(times)


def machine() -> Work:
    """What one thread does per second: bytes, operations, gathers."""
    x = torch.rand(LARGE)
    moved = 2 * x.nbytes / best_seconds(LaneFunction(copied), x)
    x = torch.rand(SMALL)
    operations = SMALL * CHAINS * STEPS * 2 / best_seconds(LaneFunction(computed), x)
    index = torch.randint(ENTRIES, (SMALL,), dtype=torch.int32)
    gathers = SMALL * 16 / best_seconds(LaneFunction(read, ("table",)), torch.rand(ENTRIES), index)
    return Work(moved, operations, gathers)


class Loops:
    """Seconds and work of the loops by the function's name."""

    def __init__(self):
        self.seconds: dict[str, float] = defaultdict(float)
        self.unread: dict[str, float] = defaultdict(float)  # seconds without gathers
        self.work: dict[str, Work] = defaultdict(Work)


@contextmanager
def watched(unread: dict[Compiled, Later[CpuLoop]]) -> Iterator[Loops]:
    """Watches all compiled functions while it is open; `unread` remembers their loops without gathers."""
    loops, names, programs = Loops(), {}, {}
    prepare, run = LaneFunction.prepared, Compiled.run

    def prepared(function: LaneFunction, *arguments):
        found = prepare(function, *arguments)
        if id(found[0]) not in names:
            names[id(found[0])], programs[id(found[0])] = function.name, function.traced(found[1])[0]
        return found

    def running(compiled: Compiled, given: Arguments, outputs: list[int]) -> None:
        name, program = names[id(compiled)], programs[id(compiled)]
        code, elsewhere = compiled.loop, [torch.empty(given.lanes, dtype=dtype) for dtype in compiled.dtypes]
        if compiled not in unread:
            unread[compiled] = Later(partial(without_reads, program))
            unread[compiled].result()
            compiled.load()
        for loop, results, seconds in ((unread[compiled], [tensor.data_ptr() for tensor in elsewhere], loops.unread),
                                       (code, outputs, loops.seconds)):
            compiled.loop, start = loop, time.thread_time()
            run(compiled, given, results)
            seconds[name] += time.thread_time() - start
        compiled.loop = code
        loops.work[name] = loops.work[name].plus(program, given.lanes)

    with patch.object(LaneFunction, "prepared", prepared), patch.object(Compiled, "run", running):
        yield loops


def rows(name: str, rounds: int, quick: bool, limits: Work) -> Iterator[str]:
    """The lines of the table for one scene."""
    make, setting = SCENES[name]
    with tempfile.TemporaryDirectory() as folder:
        ours = Ours(make(Path(folder), QUICK if quick else setting), compiled=True)
    ours.run(0)
    passes, unread = [], {}
    with watched(unread):
        ours.run(0)
    for seed in range(1, rounds + 1):
        with watched(unread) as loops:
            ours.run(seed)
        passes.append(loops)
    for function, work in passes[-1].work.items():
        seconds = statistics.median(loops.seconds[function] for loops in passes)
        unread_seconds = statistics.median(loops.unread[function] for loops in passes)
        least = [amount / rate for amount, rate in zip(work, limits)]
        cells = [name, function, *(f"{1000 * value:.1f}" for value in (seconds, *least)), f"{seconds / max(least):.1f}",
                 f"{seconds / sum(least):.1f}", f"{1000 * unread_seconds:.1f}"]
        yield f"| {' | '.join(cells)} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", choices=SCENES, nargs="+", default=list(SCENES))
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--quick", action="store_true", help="tiny images, to see that it works")
    options = parser.parse_args()
    torch.set_num_threads(1)
    KernelCode.first = partial(KernelCode.made, well=True)  # at once, for small renderings as well
    limits = machine()
    print(f"one thread: {limits.moved / 1e9:.1f} GB/s, {limits.operations / 1e9:.1f} billion operations and "
          f"{limits.gathers / 1e9:.2f} billion gathers a second (float32)\n")
    print("| scene | function | ms | memory, ms | arithmetic, ms | gathers, ms | x the greatest | x the sum | "
          "without gathers, ms |\n|---|---|---|---|---|---|---|---|---|")
    for name in options.scene:
        for line in rows(name, options.rounds, options.quick, limits):
            print(line, flush=True)


if __name__ == "__main__":
    main()
