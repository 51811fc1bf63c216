"""A plate of glass whose caustic is a picture, beside Mitsuba's loop: ``python -m benchmarks.caustic`` (needs Mitsuba).

The set-up of Mitsuba's tutorial on caustics (`benchmarks/scenes/caustic.py`): parallel light falls through a plate of glass
onto a floor, and its upper side is shaped until the light on the floor shows a picture. An image has 128 x 128 pixels and a
gaussian filter. Heights are a grid of 32^2 that doubles after 40, 160, 360 and 640 steps; Adam has a rate of 3e-5; after 700
and 900 steps there are twice the samples, by half the rate. The loss is the mean square of the difference of image and
picture, each over its mean. Two pictures that are drawn by code have the place of the tutorial's.

    Mitsuba    the tutorial's loop: a mesh of 512 x 512 vertices, `ptracer`, 64 samples in images and 32 in derivatives
    ours       the same steps with a normal map of 512 x 512 texels, the vertex normals of that mesh, which plain torch makes
               of the heights; `ptracer`, as many samples

Mitsuba takes ``--its`` steps, or fewer if ``--seconds`` are over before, and ours goes on until Mitsuba's seconds are over.
Steps that compile come first and count for nothing. It prints losses after equal steps and after equal seconds: `loss`, the
mean of the last ten as the loop has seen them, with the noise of its images; `anew`, of an image by Mitsuba with many
samples, of either plate as a mesh; and ours over Mitsuba's. It writes caustics.png (pictures, caustics by Mitsuba, plates)
and curves.png, where a dashed line is Mitsuba's last loss. Run it on an idle machine.
"""

from __future__ import annotations

import argparse
import bisect
import statistics
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import interpolate

import torch_radbp as rb
from benchmarks.caustic_loops import Loop, MitsubaLoop, MitsubaPlate, OurLoop
from benchmarks.headline.chart import panel, write_chart
from benchmarks.headline.race import Curve
from benchmarks.peers import mitsuba_for
from benchmarks.scenes.caustic import PICTURES, PIXELS

EVERY, SHARES = 10, (0.25, 0.5, 1.0)  # steps between plates; of the seconds, after which losses are printed
STEPS = (20, 40, 80, 120, 160, 200, 300, 400, 600, 800, 1000)  # after which losses are printed


class Run(NamedTuple):
    """Seconds and losses after steps, and plates after every tenth."""

    seconds: list[float]
    losses: list[float]
    plates: list[Tensor]

    def until(self, seconds: float) -> int:
        """The steps that were over by then, whole tens."""
        return max(bisect.bisect(self.seconds, seconds) // EVERY, 1) * EVERY

    def loss(self, steps: int) -> float:
        """The mean of the last ten losses before so many steps were over."""
        return statistics.fmean(self.losses[steps - EVERY:steps])

    def plate(self, steps: int) -> Tensor:
        """The heights after them."""
        return self.plates[steps // EVERY - 1]

    def curve(self) -> Curve:
        """Losses over seconds."""
        steps = range(EVERY, len(self.losses) + 1, EVERY)
        return Curve([0.0, *(self.seconds[step - 1] for step in steps)], [self.losses[0], *map(self.loss, steps)], True)


def run(loop: Loop, its: int, seconds: float) -> Run:
    """So many steps, in tens, or fewer where the seconds are over before."""
    found = Run([], [], [])
    while len(found.losses) < its and (not found.seconds or found.seconds[-1] < seconds):
        start = time.perf_counter()
        losses = [loop.step(len(found.losses) + number) for number in range(EVERY)]
        took, before = time.perf_counter() - start, found.seconds[-1] if found.seconds else 0.0
        found.seconds.extend(before + took * (number + 1) / EVERY for number in range(EVERY))
        found.losses.extend(losses)
        found.plates.append(loop.heights())
    return found


class Judge:
    """Images by Mitsuba of plates, as meshes."""

    def __init__(self, plate: MitsubaPlate, spp: int):
        self.plate, self.spp = plate, spp

    def image(self, heights: Tensor) -> Tensor:
        """(PIXELS, PIXELS) over the mean."""
        self.plate.move(self.plate.mi.Float(heights.numpy().ravel()))
        image = torch.from_numpy(np.array(self.plate.mi.render(self.plate.scene, seed=10**6, spp=self.spp))).mean(-1)
        return image / image.mean()

    def loss(self, heights: Tensor, picture: Tensor) -> float:
        """The mean square of the difference of both."""
        return float((self.image(heights) - picture).square().mean())


def report(name: str, runs: dict[str, Run], judge: Judge, picture: Tensor) -> list[str]:
    """The rows of a picture's table."""
    ours, theirs = runs["ours"], runs["Mitsuba"]
    its = [steps for steps in STEPS if steps <= min(len(ours.losses), len(theirs.losses))]
    seconds = [share * theirs.seconds[-1] for share in SHARES]
    places = [(f"{steps} steps", steps, steps) for steps in its]
    places += [(f"{each:.0f} s ({ours.until(each)}, {theirs.until(each)} steps)", ours.until(each), theirs.until(each))
               for each in seconds]
    rows = []
    for after, mine, other in places:
        losses = ours.loss(mine), theirs.loss(other)
        anew = judge.loss(ours.plate(mine), picture), judge.loss(theirs.plate(other), picture)
        cells = [f"{pair[0]:.4f} | {pair[1]:.4f} | {pair[0] / pair[1]:.2f}" for pair in (losses, anew)]
        rows.append(f"| {name} | {after} | {' | '.join(cells)} |")
    return rows


def shown(heights: Tensor) -> Tensor:
    """(1, PIXELS, PIXELS) from the lowest, black, to the highest, white."""
    least, most = heights.aminmax()
    return interpolate(((heights - least) / (most - least))[None, None], size=(PIXELS, PIXELS), mode="area")[0]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--its", type=int, default=50, help="steps of Mitsuba's, in tens; the tutorial has 1000")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="of each side at the most")
    parser.add_argument("--pictures", nargs="*", default=[*PICTURES], choices=PICTURES)
    parser.add_argument("--spp", type=int, default=256, help="samples of the images that judge")
    parser.add_argument("--out", type=Path, default=Path("runs/caustic"), help="the folder of the pictures")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    mi, rows, panels = mitsuba_for("cpu"), {}, []
    print("| picture | after | ours: loss | Mitsuba | ratio | ours: anew | Mitsuba | ratio |", "|---" * 8 + "|", sep="\n")
    with tempfile.TemporaryDirectory() as folder:
        plate = MitsubaPlate(mi, Path(folder))
        judge = Judge(plate, options.spp)
        for name in options.pictures:
            picture, runs = PICTURES[name](), {}
            loops: dict[str, Callable[[Tensor], Loop]] = {"Mitsuba": lambda each: MitsubaLoop(each, plate), "ours": OurLoop}
            its, seconds = options.its, options.seconds
            for side, loop in loops.items():
                loop(picture).step(0)  # compiles
                runs[side] = run(loop(picture), its, seconds)
                its, seconds = STEPS[-1], runs[side].seconds[-1]
                print(f"{name}, {side}: {len(runs[side].losses)} steps, {seconds:.1f} s", file=sys.stderr, flush=True)
            print("\n".join(report(name, runs, judge, picture)), flush=True)
            caustics = [judge.image(runs[side].plates[-1])[None] for side in runs]
            plates = [shown(found.plates[-1]) for found in runs.values()]
            rows[name] = [each / picture.max() for each in (picture[None], *caustics)] + plates
            panels.append(panel(f"caustic: {name}", "loss", {side: [found.curve()] for side, found in runs.items()},
                                runs["Mitsuba"].loss(len(runs["Mitsuba"].losses))))
        labels = ["picture", "Mitsuba's", "ours", "Mitsuba's plate", "our plate"]
        options.out.mkdir(parents=True, exist_ok=True)
        rb.save_image(options.out / "caustics.png", rb.contact_sheet(rows, labels))
        write_chart(options.out / "curves.png", panels)


if __name__ == "__main__":
    main()
