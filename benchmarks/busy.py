"""Steps beside busy processes: ``python -m benchmarks.busy`` (needs mitsuba==3.9.1 and LLVM).

This renderer and Mitsuba (``prb`` in ``llvm_ad_rgb``) take turns within one process, step by step, beside 0, 1, 2, 4 and 8
processes that compute without end. `tutorial` is the first loop that anybody writes: the Cornell box with 128 x 128 pixels
at 4 samples, mean squared error, Adam, one colour. The others are the scenes of `versus_mitsuba`, small, forward and
backward. Image and derivative have samples of their own on both sides. Medians of the rounds are compared.

`torchrun` compares processes that render at the same time and add up their gradients (gloo) with one that has all cores:
steps a second of all of them together, over those of the one.

    python -m benchmarks.busy --scene tutorial --busy 4                                  # one row
    python -m benchmarks.busy --scene metal-mesh --resolution 64 --spp 1 --busy 0 4
    python -m benchmarks.busy --scene torchrun
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
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import product
from pathlib import Path

import torch
from rich.console import Console
from rich.table import Table

from benchmarks.peers import Mitsuba, Ours, Pass, timed
from benchmarks.scenes import ALL, SCENES
from benchmarks.scenes.cornell_box import cornell_box
from benchmarks.scenes.description import BenchmarkScene, Setting

HERE = Path(__file__).resolve().parents[1]
TUTORIAL, TORCHRUN = "tutorial", "torchrun"
LOOP = Setting(resolution=128, spp=4, max_depth=6)
COLOUR = "red.reflectance.value"
RATE = 0.05  # of Adam
RESOLUTIONS, SAMPLES, NEIGHBOURS = (64, 128), (1, 4), (0, 1, 2, 4, 8)
SETTLING = 0.5  # seconds until neighbours run and processors know it
WARM_UP = 3  # steps


class OurSteps(Ours):
    """Steps of this renderer whose derivative has samples of its own, as Mitsuba's has."""

    def rendering(self, seed: int) -> torch.Tensor:
        return self.renderer(seed=2 * seed, seed_grad=2 * seed + 1)


class OurLoop:
    """The loop of the tutorial with this renderer."""

    def __init__(self, scene: BenchmarkScene) -> None:
        self.renderer = scene.renderer(compiled=True)
        with torch.no_grad():
            self.target = self.renderer(seed=10**6, spp=64)
        self.colour = self.renderer.scene.get_parameter(COLOUR)
        self.colour.data.fill_(0.2)
        self.optimizer = torch.optim.Adam([self.colour], lr=RATE)

    def run(self, seed: int) -> Pass:
        """One step."""
        def forward() -> torch.Tensor:
            self.optimizer.zero_grad()
            return self.renderer(seed=2 * seed, seed_grad=2 * seed + 1)

        def backward(image: torch.Tensor) -> None:
            (image - self.target).square().mean().backward()
            self.optimizer.step()
            with torch.no_grad():
                self.colour.clamp_(0, 1)

        return timed(forward, backward, lambda: None)


class MitsubaLoop(Mitsuba):
    """The loop of the tutorial with Mitsuba."""

    def __init__(self, scene: BenchmarkScene) -> None:
        super().__init__(scene)
        self.target = self.mi.render(self.scene, integrator=self.integrator, spp=64, seed=10**6)
        self.parameters[COLOUR] = self.mi.Color3f(0.2)
        self.parameters.update()
        self.optimizer = self.mi.ad.Adam(lr=RATE)
        self.optimizer[COLOUR] = self.parameters[COLOUR]
        self.parameters.update(self.optimizer)
        self.dr.eval(self.target)

    def run(self, seed: int) -> Pass:
        """One step."""
        dr, optimizer = self.dr, self.optimizer

        def forward():
            image = self.mi.render(self.scene, self.parameters, integrator=self.integrator, spp=self.spp, seed=2 * seed,
                                   seed_grad=2 * seed + 1)
            dr.eval(image)
            return image

        def backward(image) -> None:
            dr.backward(dr.mean(dr.square(image - self.target), axis=None))
            optimizer.step()
            optimizer[COLOUR] = dr.clip(optimizer[COLOUR], 0, 1)
            self.parameters.update(optimizer)
            dr.eval(self.parameters[COLOUR])

        return timed(forward, backward, dr.sync_thread)


@contextmanager
def busy_processes(number: int) -> Iterator[list[subprocess.Popen]]:
    """So many processes that compute without end, as long as the context lasts."""
    processes: list[subprocess.Popen] = []
    try:
        for _ in range(number):
            processes.append(subprocess.Popen([sys.executable, "-c", "while True: pass"]))
        time.sleep(SETTLING if number else 0)
        yield processes
    finally:
        for process in processes:
            process.kill()
            process.wait()


def measure(options: argparse.Namespace) -> list[dict]:
    """Times of both renderers on one scene, in this process, for each number of neighbours."""
    with tempfile.TemporaryDirectory() as folder:
        if options.only == TUTORIAL:
            scene = cornell_box(LOOP._replace(resolution=options.resolution[0], spp=options.spp[0]))
            scene = scene._replace(parameters=(COLOUR,))
            ours, theirs = OurLoop(scene), MitsubaLoop(scene)
        else:
            make, setting = ALL[options.only]
            scene = make(Path(folder), setting._replace(resolution=options.resolution[0], spp=options.spp[0]))
            ours, theirs = OurSteps(scene, compiled=True), Mitsuba(scene)
    for seed in range(WARM_UP):
        ours.run(seed), theirs.run(seed)
    found = []
    for number in options.busy:
        with busy_processes(number):
            passes = [(ours.run(seed).both, theirs.run(seed).both) for seed in range(WARM_UP, WARM_UP + options.rounds)]
        found.append({"scene": options.only, "resolution": options.resolution[0], "spp": options.spp[0], "busy": number,
                      "ours": [mine for mine, _ in passes], "mitsuba": [other for _, other in passes]})
    return found


def render_as_rank(options: argparse.Namespace) -> None:
    """Steps of one process of several; the first prints the seconds of each."""
    from torch import distributed

    several = "RANK" in os.environ
    if several:
        distributed.init_process_group("gloo")
    rank = distributed.get_rank() if several else 0
    loop = OurLoop(cornell_box(LOOP._replace(resolution=options.resolution[0],
                                             spp=options.spp[0]))._replace(parameters=(COLOUR,)))
    add_up = loop.optimizer.register_step_pre_hook(lambda *_: distributed.all_reduce(loop.colour.grad)) if several else None
    seconds = []
    for seed in range(WARM_UP + options.rounds):
        start = time.perf_counter()
        loop.run(seed + 10**4 * rank)
        seconds.append(time.perf_counter() - start)
    if rank == 0:
        print(json.dumps(seconds[WARM_UP:]), flush=True)
    if several:
        add_up.remove()
        distributed.destroy_process_group()
        sys.stdout.flush()
        os._exit(0)  # gloo's threads may still hold a gradient, and abort an interpreter that ends meanwhile


def throughput(options: argparse.Namespace) -> list[dict]:
    """Seconds of a step of one process, and of each of several under torchrun, by turns."""
    arguments = ["-m", "benchmarks.busy", "--as-rank", "--rounds", str(options.rounds), "--resolution",
                 str(options.resolution[0]), "--spp", str(options.spp[0])]
    torchrun = ["-m", "torch.distributed.run", "--standalone", "--nproc-per-node", str(options.processes)]
    alone, together = [], []
    for _ in range(options.turns):
        for seconds, command in ((alone, arguments), (together, [*torchrun, *arguments])):
            done = subprocess.run([sys.executable, *command], stdout=subprocess.PIPE, text=True, check=True, cwd=HERE)
            seconds += json.loads(done.stdout.splitlines()[-1])
    return [{"scene": TORCHRUN, "resolution": options.resolution[0], "spp": options.spp[0], "busy": 0, "alone": alone,
             "together": together, "processes": options.processes}]


def in_own_process(name: str, resolution: int, spp: int, options: argparse.Namespace) -> list[dict] | None:
    """`measure` in a new process, whose home folder holds no kernels of Mitsuba; None if it has failed and said why."""
    command = [sys.executable, "-m", "benchmarks.busy", "--only", name, "--resolution", str(resolution), "--spp", str(spp),
               "--rounds", str(options.rounds), "--busy", *map(str, options.busy)]
    with tempfile.TemporaryDirectory() as home:
        done = subprocess.run(command, stdout=subprocess.PIPE, text=True, cwd=HERE, env={**os.environ, "HOME": home,
                              "RADBP_KERNEL_CACHE": "off"})
    return None if done.returncode else json.loads(done.stdout.splitlines()[-1])


def cells(found: dict) -> list[str]:
    """The row of the table for one measurement."""
    head = [found["scene"], f"{found['resolution']} x {found['resolution']}, {found['spp']}", str(found["busy"])]
    if found["scene"] == TORCHRUN:
        alone, together = (statistics.median(found[key]) for key in ("alone", "together"))
        return [*head, f"{1e3 * together:.1f}", f"{1e3 * alone:.1f}", f"{found['processes'] * alone / together:.2f}"]
    ours, theirs = (statistics.median(found[key]) for key in ("ours", "mitsuba"))
    return [*head, f"{1e3 * ours:.1f}", f"{1e3 * theirs:.1f}", f"{ours / theirs:.2f}"]


def table(results: list[dict]) -> Table:
    """Medians in milliseconds, and their ratios."""
    shown = Table(caption_justify="left", caption="ms a step, ours and Mitsuba's, and the first over the second; torchrun: "
                  "a step of each of the processes, of one alone, and the throughput of all of them over that of one")
    for heading in ("scene", "pixels, samples", "busy beside", "ours", "Mitsuba", "ratio"):
        shown.add_column(heading, justify="left" if heading == "scene" else "right", no_wrap=True)
    for found in results:
        shown.add_row(*cells(found))
    return shown


def cases(options: argparse.Namespace) -> Iterator[tuple[str, int, int]]:
    """Name, pixels a side and samples a pixel of all that is asked for."""
    for name in options.scene:
        loop = name in (TUTORIAL, TORCHRUN)
        yield from product([name], options.resolution or ([LOOP.resolution] if loop else RESOLUTIONS),
                           options.spp or ([LOOP.spp] if loop else SAMPLES))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", choices=[TUTORIAL, *ALL, TORCHRUN], nargs="+", default=[TUTORIAL, *SCENES, TORCHRUN])
    parser.add_argument("--busy", type=int, nargs="+", default=NEIGHBOURS, help="how many processes beside")
    parser.add_argument("--rounds", type=int, default=31, help="steps of each renderer for a row")
    parser.add_argument("--resolution", type=int, nargs="+", help="pixels a side; default: 64 and 128, of the loop 128")
    parser.add_argument("--spp", type=int, nargs="+", help="samples a pixel; default: 1 and 4, of the loop 4")
    parser.add_argument("--processes", type=int, default=2, help="under torchrun")
    parser.add_argument("--turns", type=int, default=2, help="how often torchrun and one process alone follow each other")
    parser.add_argument("--json", type=Path, help="also write the seconds of all steps to this file")
    parser.add_argument("--only", choices=[TUTORIAL, *ALL], help=argparse.SUPPRESS)
    parser.add_argument("--as-rank", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.only:
        print(json.dumps(measure(options)))
        return
    if options.as_rank:
        render_as_rank(options)
        return
    console, results, failed = Console(), [], []
    for name, resolution, spp in list(cases(options)):  # before `options` changes
        options.resolution, options.spp = [resolution], [spp]
        found = throughput(options) if name == TORCHRUN else in_own_process(name, resolution, spp, options)
        if found is None:
            failed.append(name)
            continue
        results += found
        for measured in found:
            console.print(*cells(measured), sep=", ", style="dim")
        if options.json:
            options.json.write_text(json.dumps(results, indent=1))
    console.print(table(results))
    if failed:
        raise SystemExit(f"failed: {', '.join(failed)}")


if __name__ == "__main__":
    main()
