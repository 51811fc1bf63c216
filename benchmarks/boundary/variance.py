"""The variance of what borders of shadows add to derivative images."""

from __future__ import annotations

from collections.abc import Iterable

import torch

import torch_radbp as rb
from tests.scenes.moving import MovingScene
from tests.scenes.shadows import SHADOWS

SPP, SEEDS = 512, 6


def variance(moving: MovingScene) -> tuple[float, float]:
    """Of the derivative image: the variance and the square of the mean, both means over its numbers."""
    scene = moving.build()
    images = torch.stack([rb.jvp(scene, {moving.name: moving.tangent(scene)}, spp=SPP, seed=seed, max_depth=moving.max_depth,
                                 sampling=moving.samplings[0], terms=("shadow",)) for seed in range(SEEDS)]).double()
    return float(images.var(0).mean()), float(images.mean(0).square().mean())


def print_table(names: Iterable[str]) -> None:
    print("| scene | variance | over the squared mean |\n|---|---|---|", flush=True)
    for name in names:
        noise, size = variance(SHADOWS[name])
        print(f"| {name} | {noise:.2e} | {noise / size:.2e} |", flush=True)
