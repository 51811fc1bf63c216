"""The table of a card beside Mitsuba's `cuda_ad_rgb`: ``python -m benchmarks.gpu_table --device cuda``.

Six scenes at three sizes, each scene in a process of its own, in which both renderers take turns: medians of five passes,
before each of which the parameters change a little. Beside the times:

* first call: forward and backward pass at the first size, which compiles, with no kernels kept on disk by either;
* equal noise: variance times seconds, of the image and of the gradients, each renderer with its own sampler;
* kernels: the share of a forward pass in which the card computes, by torch's profiler;
* graphs: the share of sequences of launches in a pass that one call of the driver starts, since they come again;
* plan over peak: `Renderer.memory_plan` over the memory that torch has allocated in a pass at most.

Every figure is saved when it is known, and what takes long comes last, so that a run that is cut off at `--seconds` has told
what it could. Without Mitsuba ours are told alone. ``--device cpu --quick`` runs all of it on a processor, to see that it
works.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from importlib import util
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import torch

from benchmarks.device_figures import peak_on_device
from benchmarks.noise import PIXELS, Spread
from benchmarks.peers import Mitsuba, Ours, Pass, change
from benchmarks.scenes import QUICK, SCENES
from benchmarks.scenes.description import BenchmarkScene, Setting, without_samplers
from benchmarks.versus_mitsuba import z_score
from torch_radbp.jit.nvidia.driver import Driver
from torch_radbp.jit.nvidia.gpu import Gpu

OURS, MITSUBA = "ours", "Mitsuba"
SIZES = ((512, 64), (128, 4), (256, 1))  # pixels a side, samples a pixel
LAST = "principled-interior"  # in which a pass of Mitsuba's takes ten seconds
NOISE_SIZE, NOISE_PASSES = (128, 4), 12
BOUNDS = {"forward": 0.8, "both": 0.33, "both, small": 0.5, "first call": 1.5, "noise of the image": 0.3,
          "noise of gradients": 0.3, "kernels": 0.85, "plan / peak": 1.2}  # of kernels at least, of others at most


class Bound(NamedTuple):
    """A figure of a scene beside its bound."""

    name: str  # of `BOUNDS`
    figure: float

    @property
    def is_met(self) -> bool:
        return self.figure >= BOUNDS[self.name] if self.name == "kernels" else self.figure <= BOUNDS[self.name]


def order(names: Sequence[str]) -> list[str]:
    """The scenes, those that take long last."""
    return sorted(names, key=lambda name: name == LAST)


# -- In the process of a scene ------------------------------------------------------------------------------------------


def peers_of(scene: BenchmarkScene, device: str) -> dict[str, Any]:
    """The renderers that are compared."""
    return ({MITSUBA: Mitsuba(scene, device)} if util.find_spec("mitsuba") else {}) | {OURS: Ours(scene, True, device)}


def figures_of(name: str, device: str, sizes: Sequence[tuple[int, int]], rounds: int, noise_passes: int,
               depth: int | None) -> Iterator[dict]:
    """What is found of a scene, one after the other: of each size, and of the noise.

    Args:
        name: of the scene.
        device: "cpu" or "cuda".
        sizes: pixels a side and samples a pixel; the first call is of the first.
        rounds: passes of each size.
        noise_passes: that the noise is found by, of the smallest of these sizes.
        depth: the greatest number of bounces; None: that of the scene.
    """
    make, setting = SCENES[name]
    setting = setting if depth is None else setting._replace(max_depth=depth)
    with tempfile.TemporaryDirectory() as folder:
        scene = make(Path(folder), setting)
        for number, (resolution, spp) in enumerate(sizes):
            yield of_size(resized(make, folder, setting, resolution, spp), device, rounds, first=number == 0)
        small = min(sizes, key=lambda size: abs(size[0] * size[1] - NOISE_SIZE[0] * NOISE_SIZE[1]))
        scene = without_samplers(resized(make, folder, setting, *small), Path(folder))
        yield {"setting": scene.setting._asdict(), "noise": noise_of(scene, device, noise_passes)}


def resized(make, folder: str, setting: Setting, resolution: int, spp: int) -> BenchmarkScene:
    """The scene with so many pixels a side and samples a pixel."""
    return make(Path(folder), setting._replace(resolution=resolution, spp=spp))


def of_size(scene: BenchmarkScene, device: str, rounds: int, first: bool) -> dict:
    """Times of both renderers at one size; of ours the share of kernels and the memory, too."""
    peers = peers_of(scene, device)
    begun = {name: peer.run(10_000)._asdict() for name, peer in peers.items()}
    for peer in peers.values():
        peer.run(10_001)
    passes: dict[str, list[dict]] = {name: [] for name in peers}
    sums: dict[str, list[dict[str, float]]] = {name: [] for name in peers}
    for seed in range(rounds):
        for name, peer in peers.items():
            passes[name].append(peer.run(seed)._asdict())
            sums[name].append(peer.gradient_sums())
    ours = peers[OURS]
    forward = statistics.median(each["forward"] for each in passes[OURS])
    return {"setting": scene.setting._asdict(), "passes": passes, "gradient_sums": sums, "first": begun if first else None,
            "kernels": kernels_share(ours, rounds, forward) if device == "cuda" else None,
            "graphs": graphs_share(ours, rounds + 1) if device == "cuda" else None,
            "peak": peak_on_device(ours, device, rounds), "planned": ours.renderer.memory_plan().peak}


def kernels_share(peer: Ours, seed: int, seconds: float) -> float:
    """The share of a forward pass, which takes so many seconds, in which the card computes."""
    with torch.no_grad():
        for parameter in peer.parameters.values():
            parameter.mul_(change(seed))
    peer.settle()
    with torch.profiler.profile(activities=[torch.profiler.ProfilerActivity.CUDA]) as profile:
        image = peer.rendering(seed)
        peer.settle()
    del image
    spans = [(event.time_range.start, event.time_range.end) for event in profile.events()
             if event.device_type == torch.autograd.DeviceType.CUDA]
    return covered(spans) / 1e6 / seconds


def graphs_share(peer: Ours, seed: int) -> float:
    """The share of the sequences of launches in a pass that are started as graphs."""
    started: Counter[str] = Counter()

    def counted(owner: type, name: str) -> None:
        start = getattr(owner, name)
        patch.setattr(owner, name, lambda *given: started.update([name]) or start(*given))

    with pytest.MonkeyPatch.context() as patch:
        counted(Gpu, "launch_all")
        counted(Driver, "play")
        peer.run(seed)
    return started["play"] / max(1, started["launch_all"])


def covered(spans: Sequence[tuple[float, float]]) -> float:
    """The length of what intervals cover together."""
    total, end = 0.0, -math.inf
    for first, last in sorted(spans):
        total += max(0.0, last - max(first, end))
        end = max(end, last)
    return total


def noise_of(scene: BenchmarkScene, device: str, passes: int) -> dict[str, dict[str, float]]:
    """For each renderer the variance of its image and of each gradient, means over entries."""
    found = {}
    for name, peer in peers_of(scene, device).items():
        spreads: dict[str, Spread] = {}
        peer.run(10_000)
        for seed in range(passes):
            peer.run(seed)
            for what, value in ({PIXELS: peer.pixels()} | peer.gradients_found()).items():
                spreads.setdefault(what, Spread()).add(value)
        found[name] = {what: spread.variance for what, spread in spreads.items()}
    return found


# -- What comes of it ---------------------------------------------------------------------------------------------------


def median_of(size: dict, name: str, what: str) -> float:
    """The median seconds of the passes of a renderer at a size: "forward", "backward" or "both"."""
    return statistics.median(getattr(Pass(**each), what) for each in size["passes"][name])


def ratio_of(size: dict, what: str) -> float | None:
    """Ours over Mitsuba's seconds; None: there is no Mitsuba."""
    return median_of(size, OURS, what) / median_of(size, MITSUBA, what) if MITSUBA in size["passes"] else None


def is_small(size: dict) -> bool:
    """True of sizes that take the host longer than a card."""
    return size["setting"]["resolution"] ** 2 * size["setting"]["spp"] <= NOISE_SIZE[0] ** 2 * NOISE_SIZE[1]


def bounds_of(figures: Sequence[dict]) -> list[Bound]:
    """What is known of a scene, beside its bounds."""
    found, both = [], {}
    for size in (each for each in figures if "passes" in each):
        small, both[str(size["setting"])] = is_small(size), ratio_of(size, "both")
        found += [("forward", ratio_of(size, "forward")),
                  ("both, small" if small else "both", ratio_of(size, "both"))]
        if size["first"] and MITSUBA in size["first"]:
            found.append(("first call", Pass(**size["first"][OURS]).both / Pass(**size["first"][MITSUBA]).both))
        if not small:
            found += [("kernels", size["kernels"]), ("plan / peak", plan_over_peak(size))]
    for each in figures:
        if MITSUBA in each.get("noise", ()):
            ratios, seconds = noise_ratios(each["noise"]), both[str(each["setting"])]
            found.append(("noise of the image", seconds * ratios.pop(PIXELS)))
            found.append(("noise of gradients", seconds * statistics.median(ratios.values())))
    return [Bound(name, figure) for name, figure in found if figure is not None]


def plan_over_peak(size: dict) -> float | None:
    """The predicted over the measured peak of memory; None: too little to be seen."""
    return size["planned"] / size["peak"] if size["peak"] else None


def noise_ratios(noise: dict[str, dict[str, float]]) -> dict[str, float]:
    """Ours over Mitsuba's variance of the image and of each gradient."""
    return {what: variance / max(noise[MITSUBA][what], 1e-300) for what, variance in noise[OURS].items()}


def worst_z(sums: dict[str, list[dict[str, float]]]) -> float | None:
    """The greatest difference of gradients, summed over the entries of a parameter, in standard errors."""
    if MITSUBA not in sums or len(sums[OURS]) < 2:
        return None
    return max((z_score(*([run[parameter] for run in sums[name]] for name in (OURS, MITSUBA)))
                for parameter in sums[OURS][0]), key=abs)


def row(name: str, size: dict) -> str:
    """The line of the table for a scene at one size."""
    resolution, spp = size["setting"]["resolution"], size["setting"]["spp"]
    theirs = f"{median_of(size, MITSUBA, 'forward'):.4f} + {median_of(size, MITSUBA, 'backward'):.4f}" if (
        MITSUBA in size["passes"]) else ""
    first = ", ".join(f"{Pass(**size['first'][who]).both:.1f}" for who in (MITSUBA, OURS) if who in (size["first"] or ()))
    ratios = [ratio_of(size, what) for what in ("forward", "backward", "both")]
    cells = [name, f"{resolution} x {resolution}, {spp}", theirs,
             f"{median_of(size, OURS, 'forward'):.4f} + {median_of(size, OURS, 'backward'):.4f}",
             *("" if ratio is None else f"{ratio:.2f}" for ratio in ratios), first,
             *("" if size[what] is None else f"{100 * size[what]:.0f} %" for what in ("kernels", "graphs")),
             f"{size['peak'] / 2**20:.0f}", *("" if figure is None else f"{figure:{how}}" for figure, how in (
                 (plan_over_peak(size), ".2f"), (worst_z(size["gradient_sums"]), "+.1f")))]
    return f"| {' | '.join(cells)} |"


HEADER = """| scene | pixels, spp | Mitsuba, s | ours, s | forward | backward | both | first call, s: Mitsuba's, ours \
| kernels | graphs | peak, MiB | plan / peak | z of gradient |
|---|---|---|---|---|---|---|---|---|---|---|---|---|"""


def summary(found: dict[str, list[dict]]) -> str:
    """How many figures keep each bound, with the worst."""
    lines = ["", "| what | bound | kept by | worst |", "|---|---|---|---|"]
    every = [(name, bound) for name, figures in found.items() for bound in bounds_of(figures)]
    for what, limit in BOUNDS.items():
        own = [(bound.figure, name, bound.is_met) for name, bound in every if bound.name == what]
        worst = (min if what == "kernels" else max)(own, default=None)
        lines.append(f"| {what} | {limit:g} | {sum(met for *_, met in own)} of {len(own)} | "
                     + (f"{worst[0]:.2f} {worst[1]} |" if worst else "not measured |"))
    return "\n".join(lines)


# -- The processes ------------------------------------------------------------------------------------------------------


def in_own_process(name: str, arguments: Sequence[str], seconds: float) -> Iterator[dict]:
    """`figures_of` in a new process, for so many seconds at most; no kernels of either renderer are kept on disk."""
    command = [sys.executable, "-m", "benchmarks.gpu_table", *arguments, "--only", name]
    with tempfile.TemporaryDirectory() as home:
        kept = {"HOME": home, "XDG_CACHE_HOME": home, "RADBP_KERNEL_CACHE": str(Path(home, "kernels"))}
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env={**os.environ, **kept}) as process:
            late = threading.Timer(max(1.0, seconds), process.kill)
            late.start()
            try:
                for line in process.stdout:
                    if line.startswith("{"):
                        yield json.loads(line)
            finally:
                process.kill()
                late.cancel()


def main(arguments: list[str] | None = None) -> int:
    """Prints the table and saves its figures; the status is 0 if every scene was measured to the end."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", choices=SCENES, nargs="+", default=list(SCENES))
    parser.add_argument("--device", choices=["cpu", "cuda"], default="cuda")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=520.0, help="after which no more is measured")
    parser.add_argument("--quick", action="store_true", help="tiny images, to see that it works")
    parser.add_argument("--json", type=Path, help="also write the figures to this file, as they come")
    parser.add_argument("--only", choices=SCENES, help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    sizes = ((32, 4), (QUICK.resolution, QUICK.spp)) if options.quick else SIZES
    if options.only:
        for figures in figures_of(options.only, options.device, sizes, options.rounds, 3 if options.quick else NOISE_PASSES,
                                  QUICK.max_depth if options.quick else None):
            print(json.dumps(figures), flush=True)
        return 0
    start, found = time.monotonic(), {}
    passed_on = ["--device", options.device, "--rounds", str(options.rounds), *["--quick"] * options.quick]
    print(HEADER, flush=True)
    for name in order(options.scene):
        figures = found.setdefault(name, [])
        for figure in in_own_process(name, passed_on, options.seconds - (time.monotonic() - start)):
            figures.append(figure)
            if "passes" in figure:
                print(row(name, figure), flush=True)
            if options.json:
                saved = [{"scene": scene, "figures": own} for scene, own in found.items()]
                options.json.write_text(json.dumps(saved, indent=1))
    print(summary(found), flush=True)
    cut = [name for name, figures in found.items() if len(figures) < len(sizes) + 1]
    if cut:
        print(f"not measured to the end: {', '.join(cut)}")
    return int(bool(cut))


if __name__ == "__main__":
    raise SystemExit(main())
