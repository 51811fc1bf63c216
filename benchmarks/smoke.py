"""Smoke from five views, beside Mitsuba's loop: ``python -m benchmarks.smoke`` (needs mitsuba==3.9.1 and LLVM).

The set-up of Mitsuba's tutorial "Volumetric inverse rendering" with a plume of our assets (`assets/shapes/plume.vol`): five
cameras on a half circle, 64 x 64 pixels, a constant sky, albedo 0.75, paths of 6 segments, images by Mitsuba's `prbvolpath`
of 512 samples. Both renderers load the same file and begin with the same thin fog.

    Mitsuba          the tutorial's loop: a grid of 16^3, 20 rounds by 8 samples, then of 64^3, 20 rounds by 64 samples; Adam
                     with a rate of 0.02 steps after each view; values are cut off at 1e-6 and 1
    ours             all views at once, 8 samples, a grid that grows from 8^3 to 64^3, a rate that falls, `rb.priors.bending`
    ours, its loop   ours in the tutorial's loop, step by step the same
    Mitsuba, our loop   our loop with Mitsuba's images and derivatives

With ``--seconds`` Mitsuba's second part goes on until they are over. The others have the seconds that Mitsuba has taken, and
the copy of its loop goes on with the second part until then; steps that compile come first and count for nothing. Errors, as
parts of the true root mean square:

    grid     root mean square of the difference of densities, at the centres of 64^3 cells
    views    the same of images rendered anew, from the five cameras
    between  from cameras between them, which no loop has seen

It prints them at a quarter, half and all of the seconds, and ours over Mitsuba's. It writes slices.png, and curves.png,
where a dashed line is a third of Mitsuba's last error. Run it on an idle machine.

At the start, a grid of equal values, Mitsuba's derivative has the wrong sign, by differences of either renderer's images:
the transmittance has no part in it where the extinction is its bound. With the tutorial's rate, which does not fall, ours
goes astray: by 8 samples the noise of its gradient is several times the gradient.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

import torch_radbp as rb
from benchmarks.headline.chart import panel, write_chart
from benchmarks.headline.race import Curve
from benchmarks.peers import mitsuba_for
from benchmarks.smoke_loops import (
    COARSE,
    FINE,
    Loop,
    MitsubaImages,
    MitsubaLoop,
    OurLoop,
    Run,
    SameLoop,
    Setup,
    run,
    scene_file,
)
from torch_radbp.optim.coarse_to_fine import resampled
from torch_radbp.training.recovery.volume_picture import volume_picture

SHARES = (0.25, 0.5, 1.0)  # of the seconds, at which errors are printed
JUDGED = 6  # grids of a run whose images are looked at


def images_of(scene: rb.Scene, grid: Tensor, spp: int) -> tuple[Tensor, Tensor]:
    """Two renderings of a grid, (2 views, 3, H, W) each, from all cameras."""
    scene.smoke.interior.sigma_t.data = torch.nn.Parameter(grid, requires_grad=False)
    first, second = (rb.render(scene, spp=spp, seed=10**6 + number) for number in range(2))
    return first, second


class Judge:
    """Errors of grids, and of images of these, without what the noise of the images adds to their squares."""

    def __init__(self, scene: Path, fine: int, spp: int):
        self.scene_file, self.scene, self.fine, self.spp = scene, rb.load(scene), fine, spp
        self.truth = self.scene.smoke.interior.sigma_t.data.detach().clone()
        self.images = images_of(self.scene, self.truth, 4 * spp)

    def of_grid(self, grid: Tensor) -> float:
        """The error of a grid."""
        found, truth = (resampled(each, (self.fine,) * 3, (False,) * 3) for each in (grid, self.truth))
        return float((found - truth).norm() / truth.norm())

    def of_images(self, grid: Tensor) -> tuple[float, float]:
        """The errors of images from the views, and from between them."""
        off, size = [found - truth for found, truth in zip(images_of(self.scene, grid, self.spp), self.images)], self.images
        views, between = (float(((one * other).mean().clamp_min(1e-10) / (true * again).mean()).sqrt())
                          for one, other, true, again in zip(*(each.chunk(2) for each in (*off, *size))))
        return views, between

    def curves(self, found: Run) -> dict[str, Curve]:
        """All errors of a run, those of images at some of its steps."""
        last = len(found.grids) - 1
        chosen = sorted({0, *(found.until(found.seconds[-1] * 2.0**-k) for k in range(JUDGED - 2)), last})
        images = [self.of_images(found.grids[number]) for number in chosen]
        seconds = [found.seconds[number] for number in chosen]
        return {"grid": Curve(found.seconds, [self.of_grid(grid) for grid in found.grids], True),
                "views": Curve(seconds, [views for views, _ in images], True),
                "between": Curve(seconds, [between for _, between in images], True)}


def targets_of(mi, scene: Path, views: int, spp: int) -> np.ndarray:
    """(views, H, W, 3) by Mitsuba."""
    loaded = mi.load_file(str(scene))
    return np.stack([np.array(mi.render(loaded, sensor=view, spp=spp, seed=10**5 + view)) for view in range(views)])


def report(runs: dict[str, Run], judge: Judge, out: Path) -> str:
    """The table; writes the pictures."""
    curves = {name: judge.curves(found) for name, found in runs.items()}
    seconds = runs["Mitsuba"].seconds[-1]
    lines = ["| seconds | loop | steps | grid | views | between | over Mitsuba's |", "|---|---|---|---|---|---|---|"]
    for share in SHARES:
        theirs = None
        for name, found in runs.items():
            number = found.until(share * seconds)
            errors = judge.of_grid(found.grids[number]), *judge.of_images(found.grids[number])
            theirs = theirs or errors
            ratios = ", ".join(f"{mine / other:.2f}" for mine, other in zip(errors, theirs))
            lines.append(f"| {share * seconds:.1f} | {name} | {number} | {' | '.join(f'{each:.4f}' for each in errors)} | "
                         f"{ratios} |")
    out.mkdir(parents=True, exist_ok=True)
    panels = [panel(f"smoke: {what}", "relative RMS", {name: [each[what]] for name, each in curves.items()},
                    curves["Mitsuba"][what].errors[-1] / 3) for what in ("grid", "views", "between")]
    write_chart(out / "curves.png", panels)
    rows = {}
    for name, grid in ({"truth": judge.truth} | {name: found.grids[-1] for name, found in runs.items()}).items():
        grid, truth = (resampled(each, (judge.fine,) * 3, (False,) * 3) for each in (grid, judge.truth))
        shown = volume_picture(grid, truth).movedim(-1, 0)
        rows[name] = [shown.expand(3, -1, -1), *images_of(judge.scene, grid, 4 * judge.spp)[0][::2]]
    rb.save_image(out / "slices.png", rb.contact_sheet(rows))
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=0.0, help="of each side; 0: what the tutorial's rounds take")
    parser.add_argument("--rounds", type=int, default=20, help="of each part of the tutorial's loop")
    parser.add_argument("--size", type=int, default=64, help="pixels a side")
    parser.add_argument("--spp", type=int, default=8, help="samples a pixel")
    parser.add_argument("--views", type=int, default=5)
    parser.add_argument("--scale", type=float, default=40.0, help="of the density")
    parser.add_argument("--out", type=Path, default=Path("runs/smoke"), help="the folder of the pictures")
    parser.add_argument("--small", action="store_true", help="tiny images and two rounds, to see that it works")
    options = parser.parse_args()
    if options.small:
        options.size, options.spp, options.rounds, options.views = 8, 2, 1, 2
    warnings.simplefilter("ignore")
    mi = mitsuba_for("cpu")
    with tempfile.TemporaryDirectory() as folder:
        scene = scene_file(Path(folder), options.views, options.size, options.scale)
        samples, fine = (16, COARSE) if options.small else (512, FINE)  # of a target
        setup = Setup(scene, targets_of(mi, scene, options.views, samples), options.spp, options.rounds, fine)
        loops: dict[str, Callable[[Setup], Loop]] = {
            "Mitsuba": lambda setup: MitsubaLoop(setup, mi), "ours": OurLoop, "ours, its loop": SameLoop,
            "Mitsuba, our loop": lambda setup: OurLoop(setup, MitsubaImages(setup, mi))}
        runs, seconds = {}, options.seconds
        for name, loop in loops.items():
            run(loop(setup._replace(rounds=1)), 1)  # compiles
            runs[name] = run(loop(setup), setup.rounds, seconds)
            seconds = seconds or runs[name].seconds[-1]
            print(f"{name}: {len(runs[name].grids) - 1} steps, {runs[name].seconds[-1]:.1f} s", file=sys.stderr, flush=True)
        print(report(runs, Judge(scene, fine, samples // 16), options.out))


if __name__ == "__main__":
    main()
