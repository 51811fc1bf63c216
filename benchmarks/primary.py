"""What the primary term costs: ``python -m benchmarks.primary``.

An image and its backward pass with the derivative of silhouettes in view, over the same without, in turns within one process
for each scene: a smooth ball under a constant light, a metal mesh under an environment map, both by their vertices, a room
of many materials by the pose of the camera, and textured things shown by instances, by the instances' poses. Medians, at
32 x 32 to 256 x 256 pixels and 16 samples. The term is what the whole takes longer, over the interior alone.

``--noise`` gives instead of the time the variance of the term's gradient over that of the interior's, both of such steps,
summed over the numbers of all parameters.

``--large`` measures a ball of 1.3 million triangles, 256 x 256 and 4 samples, in processes of their own: the first step, a
step, and the most memory that steps take.
"""

from __future__ import annotations

import argparse
import statistics
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch

import torch_radbp as rb
from benchmarks.resident import give_back, peak_of, resident
from benchmarks.scenes import ALL
from benchmarks.scenes.description import BenchmarkScene, Setting, camera, cotangent, use
from tests.scenes.meshes import icosphere
from torch_radbp.io.values.transform import rotate, scale, translate

WARM_UP = 3
SPP, DEPTH = 16, 4
SIZES = (32, 128, 256)
TERMS = {"interior": ["interior"], "both": ["interior", "primary"]}
MIB = 1 << 20


class Case(NamedTuple):
    """A scene, and what moves in it."""

    make: Callable[[Path, Setting], BenchmarkScene]
    parameters: tuple[str, ...]


def ball(subdivisions: int, smooth: bool, setting: Setting) -> BenchmarkScene:
    """A grey ball under a constant light."""
    vertices, faces = icosphere(subdivisions)
    shape = {"type": "mesh", "vertex_positions": vertices.float(), "faces": faces, "recompute_normals": smooth,
             "bsdf": {"type": "diffuse"}}
    return BenchmarkScene({"type": "scene", "sensor": camera((0, 0, 4), (0, 0, 0), 40.0, setting.resolution),
                           "sky": {"type": "constant"}, "ball": shape}, (), setting)


def things(setting: Setting) -> BenchmarkScene:
    """Nine instances of a textured ball with a cube in it, over a floor."""
    vertices, faces = icosphere(4)
    texels = np.random.default_rng(0).random((64, 64, 3)).astype(np.float32)
    paint = {"type": "diffuse", "reflectance": {"type": "bitmap", "data": texels, "raw": True}}
    group = {"type": "shapegroup", "cube": {"type": "cube", "bsdf": paint, "to_world": scale((0.6, 0.6, 0.6))},
             "ball": {"type": "mesh", "vertex_positions": vertices.float(), "faces": faces, "recompute_normals": True}}
    shown = {f"thing_{row}{column}": {"type": "instance", "shapegroup": use("group"),
                                      "to_world": translate((row, column, 0)) @ rotate((1, row, column), 40)
                                      @ scale((0.35, 0.3, 0.35))} for row in (-1, 0, 1) for column in (-1, 0, 1)}
    floor = {"type": "rectangle", "to_world": translate((0, 0, -0.6)) @ scale((3, 3, 1)), "bsdf": paint}
    return BenchmarkScene({"type": "scene", "sensor": camera((0.5, 0.5, 4.5), (0, 0, 0), 45.0, setting.resolution),
                           "sky": {"type": "constant"}, "floor": floor, "group": group, **shown}, (), setting)


CASES = {
    "ball": Case(lambda folder, setting: ball(5, True, setting), ("ball.vertex_positions",)),
    "metal mesh": Case(ALL["metal-mesh-vertices"].make, ("mesh.vertex_positions",)),
    "material room": Case(ALL["material-room"].make, ("sensor.to_world",)),
    "instances": Case(lambda folder, setting: things(setting),
                      tuple(f"thing_{row}{column}.to_world" for row in (-1, 0, 1) for column in (-1, 0, 1))),
}

Step = Callable[[int], tuple[torch.Tensor, ...]]


def steps(scene: BenchmarkScene, parameters: tuple[str, ...], terms: dict[str, list[str]] = TERMS) -> dict[str, Step]:
    """A rendering and its backward pass, which gives gradients, without and with the primary term."""
    loaded, (resolution, spp, depth) = scene.load().requires_grad_(False), scene.setting[:3]
    values = [loaded.get_parameter(name).requires_grad_() for name in parameters]
    weights = torch.from_numpy(cotangent(resolution)).permute(2, 0, 1)[None]

    def step(renderer: rb.Renderer) -> Step:
        return lambda seed: torch.autograd.grad((renderer(seed=seed) * weights).sum(), values)

    return {name: step(rb.Renderer(loaded, spp=spp, max_depth=depth, terms=own)) for name, own in terms.items()}


def took(work: Step, seed: int) -> float:
    """Milliseconds."""
    start = time.perf_counter()
    work(seed)
    return 1e3 * (time.perf_counter() - start)


def measure(name: str, setting: Setting, rounds: int) -> str:
    """The line of the table for one case."""
    make, parameters = CASES[name]
    warnings.simplefilter("ignore")
    with tempfile.TemporaryDirectory() as folder:
        works = steps(make(Path(folder), setting), parameters)
    times = {what: [] for what in works}
    for seed in range(rounds + WARM_UP):
        for what, work in works.items():
            times[what].append(took(work, seed))
    interior, both = (statistics.median(times[what][WARM_UP:]) for what in ("interior", "both"))
    return f"| {name} | {setting.resolution} | {interior:.1f} | {both:.1f} | {both / interior - 1.0:.2f} |"


def variances(name: str, setting: Setting, rounds: int) -> str:
    """The line of the table of variances for one case."""
    make, parameters = CASES[name]
    warnings.simplefilter("ignore")
    with tempfile.TemporaryDirectory() as folder:
        works = steps(make(Path(folder), setting), parameters, {"interior": ["interior"], "primary": ["primary"]})
    found = {what: torch.stack([torch.cat([gradient.flatten().double() for gradient in work(seed)])
                                for seed in range(rounds)]) for what, work in works.items()}
    interior, primary = (float(found[what].var(0).sum()) for what in ("interior", "primary"))
    return f"| {name} | {setting.resolution} | {primary / interior:.4f} |"


def measure_large(what: str, subdivisions: int, setting: Setting, rounds: int) -> str:
    """The line of the table for a large mesh, without or with the term."""
    warnings.simplefilter("ignore")
    work = steps(ball(subdivisions, False, setting), ("ball.vertex_positions",))[what]
    before = resident("VmRSS")
    first, times = took(work, 0), []
    give_back()
    held = resident("VmRSS") - before
    most = held + peak_of(lambda: times.extend(took(work, seed) for seed in range(1, rounds + 1)))
    return f"| {what} | {first:.0f} | {statistics.median(times):.0f} | {most / MIB:.0f} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--case", choices=CASES, nargs="+", default=list(CASES))
    parser.add_argument("--size", type=int, nargs="+", default=SIZES)
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--noise", action="store_true", help="variances instead of times")
    parser.add_argument("--large", action="store_true", help="1.3 million triangles instead")
    parser.add_argument("--only", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.only and options.large:
        print(measure_large(options.only, 8, Setting(256, 4, 3), options.rounds))
    elif options.only:
        print((variances if options.noise else measure)(options.only, Setting(options.size[0], SPP, DEPTH), options.rounds))
    elif options.large:
        print("| 1.3 million triangles | first step, ms | a step, ms | memory, MiB |\n|---|---|---|---|", flush=True)
        for what in TERMS:
            run(["--large", "--only", what, "--rounds", str(options.rounds)])
    else:
        columns = ["variance of the term over the interior's"] if options.noise else [
            "interior, ms", "with the primary term, ms", "the term over the interior"]
        print(f"| scene | pixels a side | {' | '.join(columns)} |\n|---|---{'|---' * len(columns)}|", flush=True)
        for name in options.case:
            for size in options.size:
                run(["--only", name, "--size", str(size), "--rounds", str(options.rounds), *["--noise"] * options.noise])


def run(arguments: list[str]) -> None:
    """Prints the line of a case that is measured in a process of its own."""
    command = [sys.executable, "-m", "benchmarks.primary", *arguments]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True)
    print(done.stdout.splitlines()[-1] if done.returncode == 0 else f"| {' '.join(arguments)} | failed |", flush=True)


if __name__ == "__main__":
    main()
