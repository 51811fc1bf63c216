"""Noise beside Mitsuba's, and noise together with time: ``python -m benchmarks.noise`` (needs mitsuba==3.9.1 and LLVM).

This renderer and Mitsuba (``prb`` in ``llvm_ad_rgb``) take turns within one process, forward and backward, on the scenes of
`versus_mitsuba` with the filter of your choice. Each turn has two passes, with samples of their own, of which the second is
timed: in a loop nobody else has used the caches just before. Image and derivative have samples of their own on both sides,
as is the default. Printed are ours over Mitsuba's: the variance of the image, mean over pixels; of the gradient of each
parameter, sum over its entries; the time of a pass forward and backward, median; and *equal noise*, which is variance
times time: what an answer of a given noise costs. Of the worst parameter the standard error of the ratio is told: where
passes are few, one that met something rare may hold most of the variance of them all. ``--busy 4`` lets four processes
compute meanwhile.
"""

from __future__ import annotations

import argparse
import json
import math
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from rich.progress import track

from benchmarks.busy import busy_processes
from benchmarks.peers import Mitsuba, Ours
from benchmarks.scenes import ALL, SCENES
from benchmarks.scenes.description import with_filter, without_samplers

SCENE, OWN = "scene", "own"  # whose samplers
FILTERS = ("box", "tent", "gaussian", "mitchell", "catmullrom", "lanczos")
PIXELS, WARM_UP = "image", 1


class Spread:
    """The variance of arrays that come one after the other. Reference: Welford 1962."""

    def __init__(self) -> None:
        self.count, self.mean = 0, 0.0
        self.squares: list[float] = []  # by how much each adds to the sum of squares, mean over entries

    def add(self, value: np.ndarray) -> None:
        self.count += 1
        off = value.astype(np.float64) - self.mean
        self.mean = self.mean + off / self.count
        self.squares.append(float(np.mean(off * (value - self.mean))))

    @property
    def variance(self) -> float:
        """The mean over entries."""
        return sum(self.squares) / (self.count - 1)

    @property
    def doubt(self) -> float:
        """The standard error of the variance, relative to it, as if each array added as much in the mean."""
        mean = statistics.fmean(self.squares[1:])
        return statistics.stdev(self.squares[1:]) / max(mean, 1e-300) / (self.count - 1) ** 0.5


def measure(options: argparse.Namespace) -> dict:
    """Ratios of one scene, in this process."""
    make, setting = ALL[options.only]
    resolution, spp = options.resolution[0], options.spp[0]
    with tempfile.TemporaryDirectory() as folder:
        scene = make(Path(folder), setting._replace(resolution=resolution, spp=spp))
        scene = with_filter(scene, options.filter, Path(folder))
        if options.sampler == OWN:
            scene = without_samplers(scene, Path(folder))
        peers = {"ours": Ours(scene, compiled=True), "theirs": Mitsuba(scene)}
    spreads: dict[str, dict[str, Spread]] = {name: {} for name in peers}
    times: dict[str, list[float]] = {name: [] for name in peers}
    for turn in track(range(-WARM_UP, (options.rounds + 1) // 2), f"{options.only}, {resolution} x {resolution}, {spp}",
                      transient=True):
        for name, peer in peers.items():
            for second in (0, 1):
                took = peer.run(2 * (turn + WARM_UP) + second).both
                if turn < 0:
                    continue
                if second:
                    times[name].append(took)
                for what, value in ({PIXELS: peer.pixels()} | peer.gradients_found()).items():
                    spreads[name].setdefault(what, Spread()).add(value)
    ours, theirs = (spreads[name] for name in ("ours", "theirs"))
    variances = {what: ours[what].variance / max(theirs[what].variance, 1e-300) for what in ours}
    doubts = {what: math.hypot(ours[what].doubt, theirs[what].doubt) for what in ours}
    return {"variances": variances, "doubts": doubts,
            "time": statistics.median(times["ours"]) / statistics.median(times["theirs"])}


def row(name: str, resolution: int, spp: int, found: dict) -> str:
    variances, time = dict(found["variances"]), found["time"]
    image = variances.pop(PIXELS)
    worst = max(variances, key=variances.get)
    ratio, doubt = variances[worst], found["doubts"][worst]
    return (f"| {name} | {resolution} x {resolution}, {spp} | {image:.2f} | {statistics.median(variances.values()):.2f} | "
            f"{ratio:.2f} +- {ratio * doubt:.2f} `{worst}` | {time:.2f} | {image * time:.2f} | "
            f"{ratio * time:.2f} +- {ratio * doubt * time:.2f} |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", choices=ALL, nargs="+", default=list(SCENES))
    parser.add_argument("--resolution", type=int, nargs="+", default=[128], help="pixels a side")
    parser.add_argument("--spp", type=int, nargs="+", default=[4, 16], help="samples a pixel")
    parser.add_argument("--filter", choices=FILTERS, default="gaussian", help="what both reconstruct the image with")
    parser.add_argument("--sampler", choices=(SCENE, OWN), default=SCENE,
                        help="scene: independent samples, as the scenes say; own: what each renderer takes if none is named")
    parser.add_argument("--rounds", type=int, default=16, help="passes of each, two in a turn")
    parser.add_argument("--busy", type=int, default=0, help="how many processes compute beside")
    parser.add_argument("--only", choices=ALL, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.only:
        print(json.dumps(measure(options)))
        return
    print(f"Ours over Mitsuba's, filter {options.filter}, sampler: {options.sampler}, {options.rounds} rounds, "
          f"{options.busy} busy processes beside.\n\n"
          "| scene | size, samples | variance of the image | of gradients, median | worst | time | equal noise, image | "
          "gradient, worst |\n|---|---|---|---|---|---|---|---|", flush=True)
    for name in options.scene:
        for resolution in options.resolution:
            for spp in options.spp:
                command = [sys.executable, "-m", "benchmarks.noise", "--only", name, "--resolution", str(resolution),
                           "--spp", str(spp), "--filter", options.filter, "--sampler", options.sampler, "--rounds",
                           str(options.rounds)]
                with busy_processes(options.busy):
                    done = subprocess.run(command, stdout=subprocess.PIPE, text=True)
                print(row(name, resolution, spp, json.loads(done.stdout.splitlines()[-1])) if done.returncode == 0
                      else f"| {name} | failed |", flush=True)


if __name__ == "__main__":
    main()
