"""Bytes that a path takes on a GPU: ``python -m benchmarks.lane_bytes``. Needs no GPU.

Of each scene, in float32: what a path carries from bounce to bounce (`PathState`), how much of that is kept for the backward
pass, what is remembered beside it of each bounce (`Step`), and the memo of that pass (`Memo`); then what a forward and
backward pass takes at its peak, and what `Renderer.memory_plan` predicts. As in `benchmarks.launches`, kernels run on the
processor and tensors say that they lie on CUDA; counted is what torch is asked for, tensor by tensor.
"""

from __future__ import annotations

import argparse
import tempfile
import warnings
from pathlib import Path
from typing import NamedTuple

import torch

import torch_radbp as rb
from benchmarks.launches import card
from benchmarks.peers import PRB
from benchmarks.scenes import ALL, SCENES
from tests.gradients import cotangent
from tests.rendering.host import exchanges
from torch_radbp.adjoint.function import RenderFunction
from torch_radbp.rendering.bounce_memory import AllocatedBytes
from torch_radbp.rendering.memory import RecordSizes

SIDE, SPP = 64, 64


class LaneBytes(NamedTuple):
    """The bytes of a path in a scene."""

    scene: str
    records: RecordSizes
    bounces: int
    forward: float  # at the peak of the pass
    both: float
    planned: float

    @property
    def plan_over_peak(self) -> float:
        return self.planned / self.both

    def row(self) -> str:
        """The line of the table."""
        cells = [self.scene, *self.records, self.bounces, f"{self.forward:.0f}", f"{self.both:.0f}", f"{self.planned:.0f}",
                 f"{self.plan_over_peak:.2f}"]
        return f"| {' | '.join(map(str, cells))} |"


HEADER = """| scene | state | kept | remembered | memo | bounces | peak, forward | both | planned | planned / peak |
|---|---|---|---|---|---|---|---|---|---|"""


def peaks(renderer: rb.Renderer) -> tuple[int, int]:
    """The bytes of a forward pass at its peak, and of both passes, on this thread."""
    with AllocatedBytes() as allocated:
        image = renderer(seed=1)
        forward, gradient = allocated.peak, cotangent(image.detach())
        with torch.no_grad():  # as autograd's engine does
            RenderFunction.backward(image.grad_fn, gradient)
    return forward, allocated.peak


def lane_bytes(name: str, side: int = SIDE, spp: int = SPP, **settings) -> LaneBytes:
    """The bytes of a path in a scene of the benchmarks; `settings`: of the renderer."""
    make, setting = ALL[name]
    found: list = []
    with tempfile.TemporaryDirectory() as folder, card(), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        scene = make(Path(folder), setting._replace(resolution=side, spp=spp))
        renderer = scene.renderer(True, terms=PRB, caster="warp", **settings)
        renderer(seed=1, spp=1).sum().backward()  # makes the caster, which asks where the vertices truly lie

        def measured() -> None:
            renderer.memory_plan()
            work = renderer.planner.workload(renderer.prepare(0, None, None, None))
            found[:] = work.records, len(work.fractions), *peaks(renderer), renderer.memory_plan().peak

        for _ in range(2):  # the first time tables are packed
            exchanges(measured)
    records, bounces, *sizes = found
    return LaneBytes(name, records, bounces, *(size / (side * side * spp) for size in sizes))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", choices=ALL, nargs="+", default=list(SCENES))
    parser.add_argument("--side", type=int, default=SIDE, help="pixels")
    parser.add_argument("--spp", type=int, default=SPP)
    options = parser.parse_args()
    print(HEADER, flush=True)
    for name in options.scene:
        print(lane_bytes(name, options.side, options.spp).row(), flush=True)


if __name__ == "__main__":
    main()
