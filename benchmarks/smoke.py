"""Smoke from five views, beside Mitsuba's loop: ``python -m benchmarks.smoke`` (needs mitsuba==3.9.1 and LLVM).

The set-up of Mitsuba's tutorial "Volumetric inverse rendering" with a plume of our assets (`assets/shapes/plume.vol`): five
cameras on a half circle, 64 x 64 pixels, a constant sky, albedo 0.75, paths of 6 segments, images by Mitsuba's `prbvolpath`
of 512 samples. Both renderers load the same file and begin with the same thin fog.

    Mitsuba          the tutorial's loop: a grid of 16^3, 20 rounds by 8 samples, then of 64^3, 20 rounds by 64 samples; Adam
                     with a rate of 0.02 steps after each view; values are cut off at 1e-6 and 1
    ours             tutorial 13's: all views at once, 8 samples, a grid that grows from 8^3 to 64^3, and a rate that falls
    ours, its loop   ours in the tutorial's loop, step by step the same

With ``--seconds`` Mitsuba's second part goes on until they are over. Ours has the seconds that Mitsuba has taken, and the
copy of its loop goes on with the second part until then; steps that compile come first and count for nothing. Errors, as
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
import bisect
import sys
import tempfile
import time
import warnings
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np
import torch
from torch import Tensor
from torch.nn.utils.parametrize import register_parametrization

import torch_radbp as rb
from benchmarks.headline.chart import panel, write_chart
from benchmarks.headline.race import Curve
from benchmarks.peers import mitsuba_for
from torch_radbp.optim.coarse_to_fine import resampled
from torch_radbp.training.recovery.volume_picture import volume_picture

PLUME = Path(__file__).parents[1] / "assets" / "shapes" / "plume.vol"
KEY, THEIR_KEY = "smoke.interior.sigma_t.data", "smoke.interior_medium.sigma_t.data"
START, LEAST, MOST = 0.002, 1e-6, 1.0
COARSE, FINE, FINER = 16, 64, 8  # cells of the two parts of the tutorial; times the samples in the second
RATE, OUR_RATE, END = 0.02, 0.2, 0.05  # of Adam; ours ends at that part of it
GROWS = (8, 16, 32, 64)  # cells of our grid, each for as long
SHARES = (0.25, 0.5, 1.0)  # of the seconds, at which errors are printed
JUDGED = 6  # grids of a run whose images are looked at


class Setup(NamedTuple):
    """What is optimised, and how."""

    scene: Path
    targets: np.ndarray  # (views, H, W, 3)
    spp: int
    rounds: int  # of each part of the tutorial's loop
    fine: int  # cells of the grid at the end


class Run(NamedTuple):
    """Seconds since the start, and the grid then; the first is the start."""

    seconds: list[float]
    grids: list[Tensor]

    def until(self, seconds: float) -> int:
        """The number of the last grid that there was by then."""
        return bisect.bisect(self.seconds, seconds) - 1


class Loop(Protocol):
    """An optimisation."""

    def step(self, number: int, done: float) -> None:
        """A step, or a round over the views; `done`: the share of the seconds that is over."""

    def grid(self) -> Tensor:
        """The density, (Z, Y, X, 1)."""


def scene_file(folder: Path, views: int, resolution: int, scale: float) -> Path:
    """The scene for both renderers; the cameras between the `views` follow these."""
    def sensor(name: str, place: float) -> str:
        angle = 180.0 * place / views - 90.0
        return f"""
  <sensor type="perspective" id="{name}"><float name="fov" value="45"/>
    <transform name="to_world"><lookat origin="0, 0, 4" target="0, 0, 0" up="0, 1, 0"/><rotate y="1" angle="{angle}"/>
    </transform>
    <film type="hdrfilm"><integer name="width" value="{resolution}"/><integer name="height" value="{resolution}"/>
      <string name="pixel_format" value="rgb"/><rfilter type="tent"/></film></sensor>"""

    sensors = [sensor(f"view_{k}", k) for k in range(views)] + [sensor(f"between_{k}", k + 0.5) for k in range(views)]
    path = folder / "smoke.xml"
    path.write_text(f"""<scene version="3.0.0">
  <integrator type="prbvolpath"><integer name="max_depth" value="6"/></integrator>{"".join(sensors)}
  <shape type="cube" id="smoke"><bsdf type="null"/>
    <medium type="heterogeneous" name="interior"><float name="scale" value="{scale}"/>
      <volume type="gridvolume" name="sigma_t"><string name="filename" value="{PLUME}"/>
        <transform name="to_world"><scale value="2"/><translate x="-1" y="-1" z="-1"/></transform></volume></medium></shape>
  <emitter type="constant"/>
</scene>
""")
    return path


class MitsubaLoop:
    """The tutorial's loop."""

    def __init__(self, setup: Setup, mi):
        import drjit as dr

        self.mi, self.dr, self.setup, self.spp = mi, dr, setup, setup.spp
        self.targets = [mi.TensorXf(target) for target in setup.targets]
        self.scene = mi.load_file(str(setup.scene))
        self.parameters = mi.traverse(self.scene)
        self.parameters.keep([THEIR_KEY])
        self.parameters[THEIR_KEY] = mi.TensorXf(np.full((COARSE, COARSE, COARSE, 1), START, np.float32))
        self.optimizer = mi.ad.Adam(lr=RATE, params={THEIR_KEY: self.parameters[THEIR_KEY]})
        self.parameters.update(self.optimizer)

    def step(self, number: int, done: float) -> None:
        dr, optimizer, fine = self.dr, self.optimizer, self.setup.fine
        if number == self.setup.rounds:
            optimizer[THEIR_KEY] = dr.upsample(optimizer[THEIR_KEY], shape=(fine, fine, fine))
            self.parameters.update(optimizer)
            self.spp *= FINER
        for view, target in enumerate(self.targets):
            image = self.mi.render(self.scene, self.parameters, sensor=view, spp=self.spp, seed=number + 1)
            dr.backward(dr.mean(dr.square(image - target), axis=None))
            optimizer.step()
            optimizer[THEIR_KEY] = dr.clip(optimizer[THEIR_KEY], LEAST, MOST)
            self.parameters.update(optimizer)
        dr.eval(optimizer[THEIR_KEY])
        dr.sync_thread()

    def grid(self) -> Tensor:
        return torch.from_numpy(np.array(self.parameters[THEIR_KEY]))


class SameLoop:
    """The tutorial's loop with this renderer."""

    def __init__(self, setup: Setup):
        self.setup, self.spp = setup, setup.spp
        self.targets = torch.from_numpy(setup.targets).permute(0, 3, 1, 2).contiguous()
        scene = rb.load(setup.scene)
        self.volume = scene.smoke.interior.sigma_t
        self.begin(torch.full((COARSE, COARSE, COARSE, 1), START))
        self.renderer = rb.Renderer(scene)

    def begin(self, data: Tensor) -> None:
        """Goes on from a grid."""
        self.volume.data = torch.nn.Parameter(data)
        self.optimizer = torch.optim.Adam([self.volume.data], lr=RATE)

    def step(self, number: int, done: float) -> None:
        if number == self.setup.rounds:
            data = self.grid()
            for axis in range(3):
                data = data.repeat_interleave(self.setup.fine // COARSE, axis)
            self.begin(data)
            self.spp *= FINER
        for view, target in enumerate(self.targets):
            self.optimizer.zero_grad()
            image = self.renderer(number * len(self.targets) + view, sensors=view, spp=self.spp)
            (image - target).square().mean().backward()
            self.optimizer.step()
            with torch.no_grad():
                self.volume.data.clamp_(LEAST, MOST)

    def grid(self) -> Tensor:
        return self.volume.data.detach().clone()


class OurLoop:
    """The loop of tutorial 13: from coarse to fine, between 0 and 1."""

    def __init__(self, setup: Setup):
        self.targets = torch.from_numpy(setup.targets).permute(0, 3, 1, 2).contiguous()
        scene = rb.load(setup.scene)
        self.volume, self.views, self.spp = scene.smoke.interior.sigma_t, range(len(setup.targets)), setup.spp
        self.volume.data = torch.nn.Parameter(torch.full((setup.fine, setup.fine, setup.fine, 1), START))
        self.coarse = rb.optim.CoarseToFine((GROWS[0],) * 3, within=rb.optim.Sigmoid())
        register_parametrization(self.volume, "data", self.coarse)
        self.optimizer = torch.optim.Adam(self.volume.requires_grad_().parameters(), lr=OUR_RATE)
        self.renderer = rb.Renderer(scene)

    def step(self, number: int, done: float) -> None:
        if self.coarse.size[0] < GROWS[min(int(done * len(GROWS)), len(GROWS) - 1)]:
            rb.optim.refine(self.volume, "data", self.optimizer)
        self.optimizer.param_groups[0]["lr"] = OUR_RATE * END**done
        self.optimizer.zero_grad()
        (self.renderer(number, sensors=self.views, spp=self.spp) - self.targets).square().mean().backward()
        self.optimizer.step()

    def grid(self) -> Tensor:
        return self.volume.data.detach().clone()


def run(loop: Loop, rounds: int, seconds: float = 0.0) -> Run:
    """Steps until the seconds are over; if there are none, both parts of the tutorial's loop."""
    found = Run([0.0], [loop.grid()])
    while found.seconds[-1] < seconds if seconds else len(found.grids) <= 2 * rounds:
        start = time.perf_counter()
        loop.step(len(found.grids) - 1, found.seconds[-1] / seconds if seconds else 0.0)
        found.seconds.append(found.seconds[-1] + time.perf_counter() - start)
        found.grids.append(loop.grid())
    return found


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
        loops = {"Mitsuba": lambda setup: MitsubaLoop(setup, mi), "ours": OurLoop, "ours, its loop": SameLoop}
        runs, seconds = {}, options.seconds
        for name, loop in loops.items():
            run(loop(setup._replace(rounds=1)), 1)  # compiles
            runs[name] = run(loop(setup), setup.rounds, seconds)
            seconds = seconds or runs[name].seconds[-1]
            print(f"{name}: {len(runs[name].grids) - 1} steps, {runs[name].seconds[-1]:.1f} s", file=sys.stderr, flush=True)
        print(report(runs, Judge(scene, fine, samples // 16), options.out))


if __name__ == "__main__":
    main()
