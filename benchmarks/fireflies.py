"""How much larger single pixels of derivatives are than usual, where bodies meet: ``python -m benchmarks.fireflies``.

Of each scene, in which a body moves, derivative images of many seeds are taken by forward mode, `rb.jvp`, and of each image
the pixel whose derivative is largest. The table has the median of these over the seeds, the largest of all over that median,
and how many are more than ten times as large as it. Paths have four segments and no roulette.
"""

from __future__ import annotations

import argparse
import time
import warnings
from typing import Any

import torch
from rich.progress import track
from torch import Tensor

import torch_radbp as rb
from benchmarks.scenes.description import NO_ROULETTE
from tests.scenes import rgb
from tests.scenes.crossings import BALL, CEILING, CUP, FLOOR, POINT, SKY, SUN, Crossing, card, plate_through_cube

SIZE, DEPTH = 16, 4  # pixels a side; segments of a path
LARGE = 10  # times the median
METAL = {"bsdf": {"type": "twosided", "one": {
    "type": "roughconductor", "distribution": "ggx", "alpha": 0.3, "specular_reflectance": rgb(0.8, 0.7, 0.6)}}}
SCENES: dict[str, tuple[Crossing, dict[str, Any]]] = {
    "plate through a cube, point light": (Crossing(plate_through_cube() | FLOOR | POINT, "plate"), {}),
    "the same, the cube moves": (Crossing(plate_through_cube() | FLOOR | POINT, "cube"), {}),
    "the same, attached sampling": (Crossing(plate_through_cube() | FLOOR | POINT, "plate"), {"sampling": "attached"}),
    "the same, of metal": (Crossing(plate_through_cube(METAL) | FLOOR | POINT, "plate"), {}),
    "plate through a cube, sun": (Crossing(plate_through_cube() | FLOOR | SUN, "plate"), {}),
    "plate through a cube, sky": (Crossing(plate_through_cube() | FLOOR | SKY, "plate"), {}),
    "plate through a cube, small lamp": (Crossing(plate_through_cube() | FLOOR | CEILING, "plate"), {}),
    "ball sunk in a floor, point light": (Crossing(BALL | FLOOR | POINT, "ball"), {}),
    "cup on a table, point light": (Crossing(CUP | FLOOR | POINT, "cup"), {}),
    "card above a table, point light": (Crossing(card(0.05) | FLOOR | POINT, "card"), {}),
}


def largest_pixels(crossing: Crossing, settings: dict[str, Any], spp: int, seeds: int) -> Tensor:
    """(seeds,) the largest derivative of a pixel in any channel, by absolute value, in the image of each seed."""
    scene = crossing.load(torch.float32, SIZE)
    tangents = {crossing.parameter: crossing.direction(scene.get_parameter(crossing.parameter).detach())}
    settings = {"spp": spp, "max_depth": DEPTH, "rr_depth": NO_ROULETTE} | settings
    return torch.stack([rb.jvp(scene, tangents, seed=seed, **settings).abs().amax()
                        for seed in track(range(seeds), crossing.name, transient=True)])


def row(name: str, largest: Tensor) -> str:
    """The line of the table for the largest pixels of a scene."""
    median = float(largest.median())
    return f"| {name} | {median:.3g} | {float(largest.max()) / median:.3g} | {int((largest > LARGE * median).sum())} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="part of a scene's name")
    parser.add_argument("--spp", type=int, default=128)
    parser.add_argument("--seeds", type=int, default=200)
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    start = time.perf_counter()
    print(f"| scene | median | largest / median | seeds above {LARGE} |\n|---|---|---|---|", flush=True)
    for name, (crossing, settings) in SCENES.items():
        if options.only in name:
            print(row(name, largest_pixels(crossing, settings, options.spp, options.seeds)), flush=True)
    print(f"\n{options.seeds} seeds, {options.spp} samples a pixel, {time.perf_counter() - start:.0f} s")


if __name__ == "__main__":
    main()
