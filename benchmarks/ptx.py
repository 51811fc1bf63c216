"""Registers, spills and reads of every kernel that a rendering on a GPU runs. Needs no GPU: NVIDIA's assembler tells.

    python -m benchmarks.ptx [--architectures sm_80 sm_90] [--scenes NAME ...] [--samplings hybrid attached]

The scenes are those of `tests/scenes/everything.py`, which together have every material, shape, light and texture,
and a room with networks; everything in them is differentiated, forward and backward, by hybrid and attached sampling. A
kernel that several of them share is listed once.
"""

from __future__ import annotations

import argparse
import re
import time
from array import array
from collections.abc import Iterator
from typing import Any, NamedTuple

from benchmarks.ptxas import Usage, assemble, find
from tests.rendering.recorded import SAMPLINGS, SCENES, calls_of, stage_named
from torch_radbp.jit.nvidia.gpu import Gpu
from torch_radbp.jit.nvidia.nvptx import ptx
from torch_radbp.jit.stages import CompiledStages

ARCHITECTURES = ("sm_80", "sm_90")


class Listing:
    """A launcher that notes the kernels and launches none."""

    architecture = ARCHITECTURES[-1]

    def __init__(self) -> None:
        self.texts: list[str] = []

    def load(self, text: str, name: str) -> Any:
        self.texts.append(text)

    def launch(self, kernel: Any, blocks: int, threads: int, parameters: array) -> None:
        raise RuntimeError("kernels are listed here, not run")


class Kernel(NamedTuple):
    """A kernel of a stage."""

    stage: str
    kind: str  # of the material that its lanes meet; of `bounce` and its adjoint
    text: str  # LLVM's

    @property
    def parameters(self) -> int:
        """How many it takes, of 8 bytes each."""
        return self.text.split("(", 1)[1].split(") #0", 1)[0].count("%")


def kernels(name: str, sampling: str) -> Iterator[Kernel]:
    """The kernels of a scene of `SCENES`."""
    for stage, cases in calls_of(name, sampling).items():
        for arguments in cases.values():
            listing = Listing()
            CompiledStages(Gpu(listing))(stage_named(stage)).fused.prepared(arguments)[0].load()
            scene = arguments[0].scene if stage == "bounce_adjoint" else arguments[0]
            scatterer = scene.layout.scatterer if stage in ("bounce", "bounce_adjoint") else None
            kind = "" if scatterer is None else type(scatterer.kind).__name__
            yield from (Kernel(stage, kind, text) for text in listing.texts)


class Counts(NamedTuple):
    """What a kernel takes of a GPU, and how often its PTX reads memory."""

    usage: Usage
    reads: int  # instructions
    fusible: int  # products and sums of which the assembler may make one instruction or two


def counts(text: str, architecture: str) -> Counts:
    """The counts of a kernel."""
    code = ptx(text, architecture)
    return Counts(assemble(code, architecture, find()), len(re.findall(r"\bld\.global", code)),
                  len(re.findall(r"\s(?:add|sub|mul)\.f(?:32|64)\b", code)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--architectures", nargs="+", default=ARCHITECTURES)
    parser.add_argument("--scenes", nargs="+", default=SCENES, choices=SCENES)
    parser.add_argument("--samplings", nargs="+", default=SAMPLINGS, choices=SAMPLINGS)
    given = parser.parse_args()
    if find() is None:
        raise SystemExit("no ptxas: install the extra `test`, or NVIDIA's CUDA toolkit")
    print(f"{'scene':>12} {'sampling':>8} {'stage':>15} {'architecture':>12} {'parameters':>10} {'registers':>9} "
          f"{'stack':>6} {'stores':>6} {'loads':>6} {'reads':>6} {'ms':>6}  materials")
    seen = set()
    for scene in given.scenes:
        for sampling in given.samplings:
            for kernel in kernels(scene, sampling):
                for architecture in given.architectures if kernel.text not in seen else ():
                    begun = time.perf_counter()
                    found, reads, _ = counts(kernel.text, architecture)
                    took = 1000 * (time.perf_counter() - begun)
                    print(f"{scene:>12} {sampling:>8} {kernel.stage:>15} {architecture:>12} {kernel.parameters:>10} "
                          f"{found.registers:>9} {found.stack:>6} {found.stores:>6} {found.loads:>6} {reads:>6} "
                          f"{took:>6.0f}  {kernel.kind}", flush=True)
                seen.add(kernel.text)


if __name__ == "__main__":
    main()
