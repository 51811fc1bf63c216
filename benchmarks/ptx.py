"""Registers, spills and reads of every kernel that a rendering on a GPU runs. Needs no GPU: NVIDIA's assembler tells.

    python -m benchmarks.ptx [--architectures sm_80 sm_90] [--scenes NAME ...] [--samplings hybrid attached] [--spilling]

The scenes are those of the benchmarks, in float32 as they are measured, and those of `tests/scenes/everything.py`, which
together have every material, shape, light and texture, and a room with networks; everything in these is differentiated, in
float64, forward and backward, by hybrid and attached sampling. A kernel that several of them share is listed once. At the
end of each scene it is said how long LLVM and the assembler took for all of its kernels.
"""

from __future__ import annotations

import argparse
import re
import tempfile
import time
import warnings
from array import array
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from benchmarks.launches import card
from benchmarks.peers import PRB
from benchmarks.ptxas import Usage, assemble, find
from benchmarks.scenes import ALL, QUICK
from benchmarks.scenes import SCENES as BENCHMARKS
from tests.gradients import cotangent
from tests.rendering.recorded import SAMPLINGS, SCENES, calls_of, stage_named
from torch_radbp.jit.lane.refusal import UnknownOperation
from torch_radbp.jit.nvidia.gpu import Gpu
from torch_radbp.jit.nvidia.nvptx import ptx
from torch_radbp.jit.run import LaneFunction
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
    """The kernels of a scene of `SCENES`; what runs eagerly has none."""
    for stage, cases in calls_of(name, sampling).items():
        for arguments in cases.values():
            listing = Listing()
            try:
                loop = CompiledStages(Gpu(listing))(stage_named(stage)).fused.prepared(arguments)[0].loop
            except UnknownOperation:
                continue
            if loop is not None:
                loop.result().kernel.loading.result()  # by a helper
            yield from (Kernel(stage, kind_of_material(stage, arguments), text) for text in listing.texts)


def kernels_of_benchmark(name: str) -> list[Kernel]:
    """The kernels that compute the lanes of a scene of the benchmarks, as a pass in float32 needs them."""
    found, traced = [], LaneFunction.traced

    def noted(self, given, *more):
        program, interface = traced(self, given, *more)
        found.append((self.name, kind_of_material(self.name, given.given), program))
        return program, interface

    with tempfile.TemporaryDirectory() as folder, card() as device, warnings.catch_warnings(), (
            pytest.MonkeyPatch.context()) as patch:
        warnings.simplefilter("ignore")
        patch.setenv("RADBP_KERNEL_CACHE", "off")
        patch.setattr(LaneFunction, "traced", noted)
        renderer = ALL[name].make(Path(folder), QUICK).renderer(True, terms=PRB, caster="warp")
        image = renderer(seed=1)
        image.backward(cotangent(image.detach()))
        return [Kernel(stage, kind, device.gpu.text(program)) for stage, kind, program in found]


def kind_of_material(stage: str, arguments: tuple) -> str:
    """The kind of the material that the lanes of a call of `bounce` or its adjoint meet; "" of any other."""
    if stage not in ("bounce", "bounce_adjoint"):
        return ""
    scene = arguments[0].scene if stage == "bounce_adjoint" else arguments[0]
    scatterer = scene.layout.scatterer
    return "" if scatterer is None else type(scatterer.kind).__name__


class Counts(NamedTuple):
    """What a kernel takes of a GPU, and how often its PTX reads memory."""

    usage: Usage
    reads: int  # instructions
    fusible: int  # products and sums of which the assembler may make one instruction or two
    llvm: float  # seconds that LLVM took,
    assembler: float  # and NVIDIA's assembler


def counts(text: str, architecture: str) -> Counts:
    """The counts of a kernel."""
    begun = time.perf_counter()
    code = ptx(text, architecture)
    made = time.perf_counter()
    usage = assemble(code, architecture, find())
    return Counts(usage, len(re.findall(r"\bld\.global", code)), len(re.findall(r"\s(?:add|sub|mul)\.f(?:32|64)\b", code)),
                  made - begun, time.perf_counter() - made)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--architectures", nargs="+", default=ARCHITECTURES)
    parser.add_argument("--scenes", nargs="+", default=(*BENCHMARKS, *SCENES), choices=(*ALL, *SCENES))
    parser.add_argument("--samplings", nargs="+", default=SAMPLINGS, choices=SAMPLINGS)
    parser.add_argument("--spilling", action="store_true", help="list only those that spill registers")
    given = parser.parse_args()
    if find() is None:
        raise SystemExit("no ptxas: install the extra `test`, or NVIDIA's CUDA toolkit")
    print(f"{'scene':>20} {'sampling':>8} {'stage':>15} {'architecture':>12} {'parameters':>10} {'registers':>9} "
          f"{'stack':>6} {'stores':>6} {'loads':>6} {'reads':>6} {'ms':>6}  materials")
    seen: set[str] = set()
    for scene in given.scenes:
        cases = [("hybrid", kernels_of_benchmark(scene))] if scene in ALL else [
            (sampling, kernels(scene, sampling)) for sampling in given.samplings]
        found = []
        for sampling, own in cases:
            for kernel in own:
                for architecture in given.architectures if kernel.text not in seen else ():
                    found.append(counts(kernel.text, architecture))
                    used, reads, _, llvm, assembler = found[-1]
                    if used.stores or not given.spilling:
                        print(f"{scene:>20} {sampling:>8} {kernel.stage:>15} {architecture:>12} {kernel.parameters:>10} "
                              f"{used.registers:>9} {used.stack:>6} {used.stores:>6} {used.loads:>6} {reads:>6} "
                              f"{1000 * (llvm + assembler):>6.0f}  {kernel.kind}", flush=True)
                seen.add(kernel.text)
        if found:
            used = [each.usage for each in found]
            llvm, assembler = sum(each.llvm for each in found), sum(each.assembler for each in found)
            print(f"{scene}: {len(found)} kernels, {max(each.registers for each in used)} registers and "
                  f"{max(each.stores for each in used)} bytes spilled at most; "
                  f"LLVM {llvm:.1f} s, assembler {assembler:.1f} s", flush=True)


if __name__ == "__main__":
    main()
