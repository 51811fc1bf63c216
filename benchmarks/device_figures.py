"""What a device does by itself: ``python -m benchmarks.device_figures --device cuda``; needs no other renderer.

For each scene of `benchmarks.scenes`, without Russian roulette, in a process of its own: the first forward and backward
pass, which compiles; the median of further ones, as samples a second; their ratio over the same passes on the CPU; and the
peak of memory during one pass, beside what `Renderer.memory_plan` predicts. On CUDA the peak is that of torch's allocator,
on the CPU that of resident memory; both count from what was there before the pass.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

import torch

from benchmarks.peers import Ours, Pass
from benchmarks.resident import MIB, peak_of
from benchmarks.scenes import QUICK, SCENES
from benchmarks.scenes.description import Setting


class Figures(NamedTuple):
    """What was measured of a scene."""

    scene: str
    device: str
    setting: Setting
    first: float  # seconds of the first forward and backward pass
    forward: float  # seconds, median
    backward: float
    on_cpu: float  # seconds of both passes on the CPU, median
    peak: int  # bytes
    predicted: int

    @property
    def samples_per_second(self) -> float:
        """Paths whose light and derivative are known, a second."""
        return self.setting.resolution**2 * self.setting.spp / (self.forward + self.backward)

    def row(self) -> str:
        """The line of the table."""
        both = self.forward + self.backward
        cells = (self.scene, self.device, f"{self.setting.resolution} x {self.setting.resolution}, {self.setting.spp}",
                 f"{self.first:.2f}", f"{self.forward:.3f} + {self.backward:.3f}", f"{self.samples_per_second / 1e6:.3f}",
                 f"{both / self.on_cpu:.3f}", f"{self.peak / MIB:.0f}", f"{self.predicted / MIB:.0f}",
                 f"{self.predicted / self.peak:.2f}" if self.peak else "")
        return f"| {' | '.join(cells)} |"


HEADER = """| scene | device | pixels, spp | first, s | forward + backward, s | million samples / s | over the CPU \
| peak, MiB | predicted, MiB | predicted / peak |
|---|---|---|---|---|---|---|---|---|---|"""


def peak_on_device(peer: Ours, device: str, seed: int) -> int:
    """The bytes of a pass at its peak, over those before."""
    if device == "cpu":
        return peak_of(lambda: peer.run(seed))
    torch.cuda.synchronize()
    torch.cuda.reset_peak_memory_stats()
    before = torch.cuda.memory_allocated()
    peer.run(seed)
    return torch.cuda.max_memory_allocated() - before


def median_passes(peer: Ours, rounds: int) -> list[Pass]:
    """Passes, after one that warms up."""
    peer.run(10_001)
    return [peer.run(seed) for seed in range(rounds)]


def measure(name: str, device: str, setting: Setting, rounds: int) -> Figures:
    """The figures of one scene, in this process, which must not have rendered before if `first` is to count."""
    make, _ = SCENES[name]
    with tempfile.TemporaryDirectory() as folder:
        scene = make(Path(folder), setting)
        peer = Ours(scene, compiled=True, device=device)
        first = peer.run(10_000).both
        passes = median_passes(peer, rounds)
        peak, predicted = peak_on_device(peer, device, rounds), peer.renderer.memory_plan().peak
        on_cpu = passes if device == "cpu" else median_passes(Ours(scene, compiled=True), 1)
    forward, backward, both = (statistics.median(map(what, found)) for what, found in (
        (lambda p: p.forward, passes), (lambda p: p.backward, passes), (lambda p: p.both, on_cpu)))
    return Figures(name, device, setting, first, forward, backward, both, peak, predicted)


def in_own_process(name: str, device: str, setting: Setting, rounds: int) -> Figures | None:
    """`measure` in a new process; None if it failed, which has printed why."""
    command = [sys.executable, "-m", "benchmarks.device_figures", "--device", device, "--rounds", str(rounds),
               "--only", json.dumps([name, setting])]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True)
    if done.returncode:
        return None
    found = Figures(*json.loads(done.stdout.splitlines()[-1]))
    return found._replace(setting=Setting(*found.setting))


def main(arguments: list[str] | None = None) -> None:
    """Prints the table, and saves its figures where wanted."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", choices=SCENES, nargs="+", default=list(SCENES))
    parser.add_argument("--device", default="cpu", help="cpu or cuda")
    parser.add_argument("--resolution", type=int, help="pixels a side; default: that of the scene")
    parser.add_argument("--spp", type=int, help="samples a pixel; default: those of the scene")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--quick", action="store_true", help="tiny images, to see that it works")
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    parser.add_argument("--only", help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.only:
        name, setting = json.loads(options.only)
        print(json.dumps(measure(name, options.device, Setting(*setting), options.rounds)))
        return
    print(HEADER, flush=True)
    results, failed = [], []
    for name in options.scene:
        setting = QUICK if options.quick else SCENES[name].setting
        setting = setting._replace(resolution=options.resolution or setting.resolution, spp=options.spp or setting.spp)
        found = in_own_process(name, options.device, setting, options.rounds)
        if found is None:
            failed.append(name)
            print(f"| {name} | failed |", flush=True)
            continue
        results.append(found)
        print(found.row(), flush=True)
        if options.json:
            options.json.write_text(json.dumps([found._asdict() | {"setting": found.setting._asdict()} for found in results],
                                               indent=1))
    if failed:
        raise SystemExit(f"failed: {', '.join(failed)}")


if __name__ == "__main__":
    main()
