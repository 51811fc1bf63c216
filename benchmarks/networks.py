"""A step with a network in the place of a texture: ``python -m benchmarks.networks``.

The Cornell box whose white walls and boxes have a colour, and the same with an MLP 2-64-64-3 instead; a step is an image,
the mean squared error, the backward pass and Adam. Image and derivative have samples of their own, as is the default.
`alone` is what the network itself must take: the values of as many points as such an image has, and the gradients of its
parameters by as many more, in plain torch, in batches of `BATCHES` points, of which the quickest counts; beside it what all
points at once take. All take turns within one process. Medians of the rounds, in milliseconds of wall time with the threads
that torch has (`OMP_NUM_THREADS`); `ratio` is (with - alone) / without.

With ``--cpu`` the CPU time of all threads, which neighbours on the machine disturb less.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import nn

import torch_radbp as rb
from benchmarks.scenes.cornell_box import cornell_box
from benchmarks.scenes.description import Setting

WARM_UP = 3  # rounds
SETTINGS = tuple(Setting(*sizes, max_depth=6) for sizes in ((64, 4), (128, 4), (256, 4), (256, 16)))
BATCHES = (1 << 12, 1 << 14)
RATE = 0.001  # of Adam


class Row(NamedTuple):
    """What is measured for one size; seconds."""

    setting: Setting
    points: int  # of an image at which the network is evaluated
    without: float
    beside: float  # with the network
    alone: float
    at_once: float  # the network alone, of all points together

    @property
    def ratio(self) -> float:
        """A step with the network over one without, less the network alone."""
        return (self.beside - self.alone) / self.without


def mlp() -> nn.Module:
    """The network, from surface coordinates to colours."""
    torch.manual_seed(0)
    return nn.Sequential(nn.Linear(2, 64), nn.ReLU(), nn.Linear(64, 64), nn.ReLU(), nn.Linear(64, 3), nn.Sigmoid())


class Step:
    """A step of an optimisation of the white walls.

    Args:
        setting: of the renderer.
        module: in the place of their colour; None: the colour.
    """

    def __init__(self, setting: Setting, module: nn.Module | None):
        scene = cornell_box(setting)._replace(parameters=() if module else ("white.reflectance.value",)).load()
        if module is not None:
            scene.white.reflectance = rb.NeuralTexture(module)
        self.renderer = rb.Renderer(scene, spp=setting.spp, max_depth=setting.max_depth)
        self.optimizer = torch.optim.Adam([value for value in scene.parameters() if value.requires_grad], lr=RATE)
        with torch.no_grad():
            self.target = self.renderer(seed=1) * 1.1

    def __call__(self, seed: int) -> None:
        self.optimizer.zero_grad()
        (self.renderer(seed=seed) - self.target).square().mean().backward()
        self.optimizer.step()


class Alone:
    """The network by itself, for the values of some points and the gradients of as many others."""

    def __init__(self, module: nn.Module, points: int, batch: int):
        generator = torch.Generator().manual_seed(0)
        places, adjoints = torch.rand(points, 2, generator=generator), torch.rand(points, 3, generator=generator)
        self.module, self.batches = module, list(zip(places.split(batch), adjoints.split(batch)))

    def __call__(self, seed: int) -> None:
        self.module.zero_grad()
        with torch.no_grad():
            for places, _ in self.batches:
                self.module(places)
        for places, adjoint in self.batches:
            self.module(places).backward(adjoint)


def points_of(step: Step, module: nn.Module) -> int:
    """The number of points of an image at which the network is evaluated."""
    counts: list[int] = []
    hook = module.register_forward_hook(lambda module, given, values: counts.append(len(values)))
    with torch.no_grad():
        step.renderer(seed=0)
    hook.remove()
    return sum(counts)


def measure(setting: Setting, rounds: int, clock: Callable[[], float] = time.perf_counter) -> Row:
    """The times of one size."""
    module = mlp()
    without, beside = Step(setting, None), Step(setting, module)
    points = points_of(beside, module)
    works = [without, beside, *(Alone(module, points, batch) for batch in (*BATCHES, points))]
    times: list[list[float]] = [[] for _ in works]
    for seed in range(WARM_UP + rounds):
        for work, found in zip(works, times):
            start = clock()
            work(seed)
            found.append(clock() - start)
    without, beside, *alone = (statistics.median(found[WARM_UP:]) for found in times)
    return Row(setting, points, without, beside, min(alone), alone[-1])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=11)
    parser.add_argument("--cpu", action="store_true", help="CPU time of all threads")
    options = parser.parse_args()
    print("| pixels, samples | points | without | with | alone | at once | ratio |", "|---" * 7 + "|", sep="\n", flush=True)
    for setting in SETTINGS:
        row = measure(setting, options.rounds, time.process_time if options.cpu else time.perf_counter)
        print(f"| {setting.resolution} x {setting.resolution}, {setting.spp} | {row.points} | {1e3 * row.without:.1f} | "
              f"{1e3 * row.beside:.1f} | {1e3 * row.alone:.1f} | {1e3 * row.at_once:.1f} | {row.ratio:.2f} |", flush=True)


if __name__ == "__main__":
    main()
