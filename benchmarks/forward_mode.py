"""Forward mode beside the image alone, and beside Mitsuba's: ``python -m benchmarks.forward_mode`` (mitsuba==3.9.1, LLVM).

An image and its derivative by one direction in the space of a parameter, by `torch.func.jvp` of one renderer and by Mitsuba
(``prb`` in ``llvm_ad_rgb``, ``dr.forward``), in turns within one process for each scene; and our image alone. Samples are
shared with the image on both sides. Medians of the rounds: ours in milliseconds, over the image alone, and over Mitsuba's. A
parameter that moves something costs more: there each bounce is taken twice. Mitsuba's `prb` has no derivative by cameras.
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

import torch
from torch.func import functional_call

import torch_radbp as rb
from benchmarks.peers import Mitsuba
from benchmarks.scenes import ALL
from benchmarks.scenes.description import NO_ROULETTE, BenchmarkScene

WARM_UP = 2


class Case(NamedTuple):
    """A derivative that is measured."""

    scene: str
    parameter: str
    of_prb: bool = True  # Mitsuba's `prb` has it, too


CASES = {"colour": Case("cornell-box", "red.reflectance.value"), "pose": Case("cornell-box", "sensor.to_world", False),
         "bitmap": Case("metal-mesh", "floor.bsdf.reflectance.data"),
         "many materials": Case("material-room", "wall.reflectance.value"),
         "vertices": Case("metal-mesh-vertices", "mesh.vertex_positions")}


def direction(value: torch.Tensor, parameter: str) -> torch.Tensor:
    """A direction in the space of a parameter: a push along x for a pose, any other by chance."""
    if parameter.endswith("to_world"):
        pushed = torch.zeros(4, 4, dtype=value.dtype)
        pushed[0, 3] = 1.0
        return pushed
    return torch.randn(value.shape, generator=torch.Generator().manual_seed(1), dtype=value.dtype)


class MitsubaTangents(Mitsuba):
    """The same derivative by Mitsuba."""

    def __init__(self, scene: BenchmarkScene, parameter: str, tangent: torch.Tensor):
        super().__init__(scene._replace(parameters=(parameter,)))
        self.parameter, self.tangent = parameter, tangent

    def derivative(self, seed: int) -> None:
        """Along a number on which the parameter depends."""
        dr, mi, name = self.dr, self.mi, self.parameter
        step, value = mi.Float(0.0), dr.detach(self.parameters[name])
        dr.enable_grad(step)
        if isinstance(value, mi.TensorXf):
            tangent = mi.TensorXf(self.tangent.numpy())
        else:
            tangent = type(value)(self.tangent.tolist() if dr.size_v(value) == 3 else self.tangent.numpy().ravel())
        self.parameters[name] = value + tangent * step
        self.parameters.update()
        image = mi.render(self.scene, self.parameters, integrator=self.integrator, spp=self.spp, seed=seed)
        dr.forward(step)
        self.tangent_image = dr.grad(image)
        dr.eval(self.tangent_image)
        dr.sync_thread()
        self.parameters[name] = value


def took(work: Callable[[int], object], seed: int) -> float:
    """Milliseconds."""
    start = time.perf_counter()
    work(seed)
    return 1e3 * (time.perf_counter() - start)


def measure(name: str, rounds: int, beside: bool) -> str:
    """The line of the table for one case."""
    case = CASES[name]
    make, setting = ALL[case.scene]
    warnings.simplefilter("ignore")
    with tempfile.TemporaryDirectory() as folder:
        described = make(Path(folder), setting)
        scene = described.load().requires_grad_(False)
        tangent = direction(scene.get_parameter(case.parameter), case.parameter)
        theirs = MitsubaTangents(described, case.parameter, tangent) if beside and case.of_prb else None
    settings = {"spp": setting.spp, "max_depth": setting.max_depth, "rr_depth": NO_ROULETTE, "share_samples": True}
    renderer = rb.Renderer(scene, **settings, terms=["interior"])

    def derivative(seed: int) -> None:
        torch.func.jvp(lambda value: functional_call(renderer, {f"scene.{case.parameter}": value}, kwargs={"seed": seed}),
                       (scene.get_parameter(case.parameter),), (tangent,))

    works = {"image": lambda seed: renderer(seed=seed), "ours": derivative}
    if theirs is not None:
        works["theirs"] = theirs.derivative
    times: dict[str, list[float]] = {what: [] for what in works}
    for seed in range(rounds + WARM_UP):
        for what, work in works.items():
            times[what].append(took(work, seed))
    median = {what: statistics.median(found[WARM_UP:]) for what, found in times.items()}
    ratio = f"{median['ours'] / median['theirs']:.2f}" if theirs is not None else ""
    return (f"| {name} | {case.scene}, `{case.parameter}` | {median['ours']:.0f} | {median['ours'] / median['image']:.2f} | "
            f"{ratio} |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--case", choices=CASES, nargs="+", default=list(CASES))
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--alone", action="store_true", help="without Mitsuba")
    parser.add_argument("--only", choices=CASES, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.only:
        print(measure(options.only, options.rounds, not options.alone))
        return
    print("| derivative by | of | ms | over the image alone | over Mitsuba's |\n|---|---|---|---|---|", flush=True)
    for name in options.case:
        command = [sys.executable, "-m", "benchmarks.forward_mode", "--only", name, "--rounds", str(options.rounds)]
        done = subprocess.run(command + ["--alone"] * options.alone, stdout=subprocess.PIPE, text=True)
        print(done.stdout.splitlines()[-1] if done.returncode == 0 else f"| {name} | failed | | | |", flush=True)


if __name__ == "__main__":
    main()
