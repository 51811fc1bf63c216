"""Where the time of a pass goes: ``python -m benchmarks.shares``.

The scenes of `versus_mitsuba`, compiled or with ``--eager``, one process each, one thread, so that every second belongs to
one part; CPU seconds, which other programs on the machine disturb less. Medians of the rounds; shares are of forward +
backward:

* closest hits, shadow rays: the casters' queries;
* fused code: loops of machine code; lane compiler: calls of them, without the loops (arguments, buffers for the results);
* scatter: sums of the lanes' adjoints into the gradients of tables;
* packing: the scene's tensors, lights' tables and the caster; its derivative: what autograd does outside of the paths;
* warnings: the search for silhouettes that move in view;
* the rest: torch's operations between the stages (survivors, the memo, sums of pixels) and Python; where the renderer is
  eager, the stages themselves.

Bounces are taken operation by operation here, from Python, so that their parts can be told; elsewhere they are recorded and
run as machine code, which leaves out most of `lane compiler` and `the rest`.

`in the kernel` is the share of all this that the operating system takes, mostly to hand out fresh pages. The peak of
memory, with the threads that torch has by default, is over what was resident before the pass; beside it what the renderer
predicts.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from unittest.mock import patch

import torch

from benchmarks.peers import Ours
from benchmarks.resident import MIB, peak_of
from benchmarks.scenes import ALL, QUICK, SCENES
from torch_radbp.adjoint import function, taped_sweep
from torch_radbp.adjoint.scatter import Gradients
from torch_radbp.boundary.terms.jump_watch import JumpWatch
from torch_radbp.jit import LaneFunction
from torch_radbp.jit.cpu import kernel_code
from torch_radbp.path import taped_bounces
from torch_radbp.raycast.direct import DirectCaster
from torch_radbp.raycast.embree import Embree
from torch_radbp.rendering.renderer import Renderer

BACKWARD, REST = "derivative of packing", "the rest"
TIMED = {  # part: what is timed for it; what is called inside of another part counts for the inner one
    "closest hits": [(DirectCaster, "intersect"), (Embree, "intersect")],
    "shadow rays": [(DirectCaster, "occluded"), (Embree, "occluded")],
    "fused code": [(kernel_code, "run_lanes")],
    "lane compiler": [(LaneFunction, "__call__"), (LaneFunction, "into")],
    "scatter": [(Gradients, "add"), (function, "gradients_of")],
    "packing": [(Renderer, "prepare")],
    BACKWARD: [(torch.Tensor, "backward")],
    "warnings": [(JumpWatch, "look")],
    REST: [(Renderer, "forward"), (function.RenderFunction, "backward")],
}


class Clock:
    """Seconds by part, as `time` tells them."""

    def __init__(self, time: Callable[[], float] = time.thread_time):
        self.time = time
        self.seconds: dict[str, float] = defaultdict(float)
        self.open: list[str] = []
        self.since = 0.0

    def turn(self) -> None:
        """Counts the time since the last turn for the innermost part."""
        now = self.time()
        if self.open:
            self.seconds[self.open[-1]] += now - self.since
        self.since = now

    def timing(self, part: str, call: Callable) -> Callable:
        """The function, timed for a part."""
        def timed(*arguments, **named):
            self.turn()
            self.open.append(part)
            try:
                return call(*arguments, **named)
            finally:
                self.turn()
                self.open.pop()

        return timed


@contextmanager
def clocked() -> Iterator[Clock]:
    """Times all parts while it is open."""
    clock = Clock()
    with ExitStack() as stack:
        for module in (taped_bounces, taped_sweep):
            stack.enter_context(patch.object(module, "recordable", lambda integrand: False))
        for part, places in TIMED.items():
            for owner, name in places:
                timed = clock.timing(part, getattr(owner, name))
                static = owner is function.RenderFunction
                stack.enter_context(patch.object(owner, name, staticmethod(timed) if static else timed))
        yield clock


def kernel_seconds() -> float:
    return os.times().system


def measure(options: argparse.Namespace) -> dict:
    """The seconds of each part on one scene, in this process, and the peak of memory."""
    make, setting = ALL[options.only]
    with tempfile.TemporaryDirectory() as folder:
        small = Ours(make(Path(folder), QUICK), not options.eager)
        ours = Ours(make(Path(folder), QUICK if options.quick else setting), not options.eager)
    small.run(0)
    peak = peak_of(lambda: ours.run(0))
    predicted = ours.renderer.memory_plan().peak
    torch.set_num_threads(1)
    ours.run(1)
    rounds: list[dict[str, float]] = []
    for seed in range(options.rounds):
        with clocked() as clock:
            kernel = kernel_seconds()
            whole = ours.run(seed).cpu
            kernel = kernel_seconds() - kernel
        outside = whole - sum(clock.seconds.values())  # the loss
        rounds.append({**clock.seconds, REST: clock.seconds[REST] + outside, "seconds": whole, "in the kernel": kernel})
    parts = [*TIMED, "seconds", "in the kernel"]
    medians = {part: statistics.median(each.get(part, 0.0) for each in rounds) for part in parts}
    return {"scene": options.only, "peak": peak, "predicted": predicted, **medians}


def in_own_process(name: str, arguments: list[str]) -> dict:
    """`measure` in a new process."""
    command = [sys.executable, "-m", "benchmarks.shares", *arguments, "--only", name]
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
    return json.loads(done.stdout.splitlines()[-1])


def row(result: dict) -> str:
    """The line of the table for one scene."""
    shares = [f"{100 * result[part] / result['seconds']:.0f}" for part in [*TIMED, "in the kernel"]]
    cells = [result["scene"], f"{result['seconds']:.2f}", *shares, f"{result['peak'] / MIB:.0f}",
             f"{result['predicted'] / MIB:.0f}"]
    return f"| {' | '.join(cells)} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", choices=ALL, nargs="+", default=list(SCENES))
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--eager", action="store_true", help="with compile=False")
    parser.add_argument("--quick", action="store_true", help="tiny images, to see that it works")
    parser.add_argument("--only", choices=ALL, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.only:
        print(json.dumps(measure(options)))
        return
    heads = ["scene", "CPU s", *(f"{part} %" for part in [*TIMED, "in the kernel"]), "peak MiB", "predicted MiB"]
    print(f"| {' | '.join(heads)} |\n|{'---|' * len(heads)}", flush=True)
    flags = [f"--{name}" for name in ("eager", "quick") if getattr(options, name)]
    for name in options.scene:
        print(row(in_own_process(name, [*flags, "--rounds", str(options.rounds)])), flush=True)


if __name__ == "__main__":
    main()
