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
from typing import NamedTuple, Protocol

import numpy as np
import torch
from torch import Tensor
from torch.func import functional_call
from torch.nn.functional import conv2d, grid_sample, interpolate, normalize, pad

import torch_radbp as rb
from benchmarks.headline.chart import panel, write_chart
from benchmarks.headline.race import Curve
from benchmarks.peers import mitsuba_for, translated
from benchmarks.scenes.caustic import GLASS, PICTURES, PIXELS, plate_scene, rectangle

PLATE, START = 512, 32  # texels or vertices a side; cells of the first grid
DOUBLES, CALMER = (40, 160, 360, 640), (700, 900)  # steps
RATE, MOST, SPP = 3e-5, 0.01, 32  # of Adam; the bound of heights
NORMALS = "scene.top.bsdf.normalmap.data"
EVERY, SHARES = 10, (0.25, 0.5, 1.0)  # steps between plates; of the seconds, after which losses are printed
STEPS = (20, 40, 80, 120, 160, 200, 300, 400, 600, 800, 1000)  # after which losses are printed


class Loop(Protocol):
    """An optimisation."""

    def step(self, number: int) -> float:
        """Takes a step; the loss before it."""

    def heights(self) -> Tensor:
        """(PLATE, PLATE) those of the plate."""


class Schedule:
    """Samples and rate of the steps to come."""

    spp, rate = SPP, RATE

    def calms(self, number: int) -> bool:
        """True if this step begins with twice the samples by half the rate."""
        if number in CALMER:
            self.spp, self.rate = 2 * self.spp, self.rate / 2
        return number in CALMER


class OurLoop:
    """The tutorial's loop with a normal map: heights are a thousandth of the way to the floor, so that nothing need move."""

    def __init__(self, picture: Tensor):
        self.picture, self.schedule = picture, Schedule()
        texture = {"type": "bitmap", "data": as_colours(torch.zeros(PLATE, PLATE)), "raw": True, "wrap_mode": "clamp"}
        glass = {"type": "normalmap", "normalmap": texture, "bsdf": GLASS, "flip_invalid_normals": False,
                 "use_shadowing_function": False}
        side = PLATE / (PLATE - 1)  # with half a texel around, so that texels have their middles at the mesh's vertices
        self.renderer = rb.Renderer(rb.load_dict(plate_scene(rectangle(0, True, side, bsdf=glass))))
        self.begin(torch.zeros(START, START))

    def begin(self, grid: Tensor) -> None:
        """Goes on from a grid, with an optimiser that has seen nothing."""
        self.grid = grid.detach().requires_grad_()
        self.optimizer = torch.optim.Adam([self.grid], lr=self.schedule.rate)

    def step(self, number: int) -> float:
        if number in DOUBLES:
            self.begin(larger(self.grid.detach(), 2 * len(self.grid)))
        if self.schedule.calms(number):
            self.optimizer.param_groups[0]["lr"] = self.schedule.rate
        image = self.image(number)
        with torch.no_grad():  # as many samples again, so that the image has twice those of its derivative
            mean = (image + self.image(number + 10**6)) / 2
        image = image + (mean - image).detach()
        loss = (image / image.detach().mean() - self.picture).square().mean()
        self.optimizer.zero_grad()
        loss.backward()
        self.optimizer.step()
        with torch.no_grad():
            self.grid.clamp_(-MOST, MOST)
        return loss.item()

    def image(self, seed: int) -> Tensor:
        """(PIXELS, PIXELS) grey."""
        normals = {NORMALS: as_colours(at_vertices(self.grid))}
        return functional_call(self.renderer, normals, kwargs={"seed": seed, "spp": self.schedule.spp})[0].mean(0)

    def heights(self) -> Tensor:
        return at_vertices(self.grid.detach())


def at_vertices(grid: Tensor) -> Tensor:
    """(PLATE, PLATE) the values of a grid, whose cells fill the plate, at the vertices of a mesh, from rim to rim."""
    across = torch.linspace(-1, 1, PLATE)
    places = torch.stack(torch.meshgrid(across, across, indexing="xy"), -1)
    return grid_sample(grid[None, None], places[None], padding_mode="border", align_corners=False)[0, 0]


def larger(grid: Tensor, size: int) -> Tensor:
    """(size, size) a grid between whose values lie straight lines."""
    return interpolate(grid[None, None], size=(size, size), mode="bilinear")[0, 0]


# The slope along u at a vertex, by heights around: that of its six faces, weighted by their angles. Along v: transposed.
SLOPE = torch.tensor([[0.0, -1.0, 1.0], [-3.0, 0.0, 3.0], [-1.0, 1.0, 0.0]]) / 8


def as_colours(heights: Tensor) -> Tensor:
    """(PLATE, PLATE, 3) the texels of a normal map, one at each vertex of a plate of 2 x 2: the normals of a smooth mesh."""
    around = pad(heights[None, None], (1, 1, 1, 1), mode="replicate") * ((PLATE - 1) / 2)
    slopes = conv2d(around, torch.stack([SLOPE, SLOPE.T])[:, None])[0]
    return (normalize(torch.stack([-slopes[0], -slopes[1], torch.ones_like(heights)], -1), dim=-1) + 1) / 2


class MitsubaPlate:
    """Mitsuba's scene, whose plate is a mesh."""

    def __init__(self, mi, folder: Path):
        import drjit as dr

        self.mi, self.ravel = mi, dr.ravel
        across = np.linspace(-1, 1, PLATE, dtype=np.float32)
        x, z = (each.ravel() for each in np.meshgrid(across, -across))
        number = np.arange(PLATE * PLATE).reshape(PLATE, PLATE)
        a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]
        faces = np.concatenate([np.stack(each, -1).reshape(-1, 3) for each in ((a, b, c), (b, d, c))])
        mesh = mi.Mesh("top", PLATE * PLATE, len(faces), has_vertex_normals=True, has_vertex_texcoords=True)
        values = mi.traverse(mesh)
        values["vertex_positions"] = np.stack([x, 0 * x, z], -1).ravel()
        values["vertex_texcoords"] = (np.stack([x, -z], -1).ravel() + 1) / 2
        values["faces"] = faces.astype(np.uint32).ravel()
        values.update()
        mesh.write_ply(str(folder / "plate.ply"))
        top = {"type": "ply", "filename": str(folder / "plate.ply"), "bsdf": GLASS}
        # Else both sides of the plate, of equal glass, become one mesh, and its new vertices take the lower one away.
        self.scene = mi.load_dict(translated(mi, plate_scene(top)), optimize=False)
        self.parameters = mi.traverse(self.scene)
        self.key = next(key for key in self.parameters.keys() if key.endswith("vertex_positions"))
        self.flat, self.uv = mi.Vector3f(x, 0 * x, z), mi.Point2f((x + 1) / 2, (1 - z) / 2)

    def move(self, heights) -> None:
        """Gives the vertices their heights."""
        self.parameters[self.key] = self.ravel(self.flat + self.mi.Vector3f(0, 1, 0) * heights)
        self.parameters.update()


class MitsubaLoop:
    """The tutorial's loop."""

    def __init__(self, picture: Tensor, plate: MitsubaPlate):
        import drjit as dr

        self.dr, self.mi, self.plate, self.schedule = dr, plate.mi, plate, Schedule()
        self.picture = self.mi.TensorXf(picture.numpy())
        self.integrator = self.mi.load_dict({"type": "ptracer", "samples_per_pass": 256 * 256, "max_depth": 4,
                                             "hide_emitters": False})
        flat = self.mi.TensorXf(np.zeros((START, START, 1), np.float32))
        self.texture = self.mi.load_dict({"type": "bitmap", "data": flat, "raw": True, "filter_type": "bilinear",
                                          "wrap_mode": "clamp"})
        self.values = self.mi.traverse(self.texture)
        self.values.keep(["data"])
        self.optimizer = self.mi.ad.Adam(lr=RATE, params=self.values)
        self.places = dr.zeros(self.mi.SurfaceInteraction3f, PLATE * PLATE)
        self.places.uv = plate.uv

    def moved(self):
        """Puts the grid on the plate; their heights."""
        self.optimizer["data"] = self.dr.clip(self.optimizer["data"], -MOST, MOST)
        self.values.update(self.optimizer)
        heights = self.texture.eval_1(self.places)
        self.plate.move(heights)
        return heights

    def step(self, number: int) -> float:
        dr, schedule = self.dr, self.schedule
        if number in DOUBLES:
            grid = torch.from_numpy(np.array(self.optimizer["data"]))[..., 0]
            self.optimizer["data"] = self.mi.TensorXf(larger(grid, 2 * len(grid))[..., None].numpy())
        if schedule.calms(number):
            self.optimizer.set_learning_rate(schedule.rate)
        self.moved()
        image = self.mi.render(self.plate.scene, self.plate.parameters, integrator=self.integrator, seed=number,
                               spp=2 * schedule.spp, spp_grad=schedule.spp)
        grey = (image[:, :, 0] + image[:, :, 1] + image[:, :, 2]) / 3
        loss = dr.mean(dr.square(grey / dr.mean(dr.detach(grey), axis=None) - self.picture), axis=None)
        dr.backward(loss)
        self.optimizer.step()
        dr.eval(self.optimizer["data"])
        return float(np.array(loss))

    def heights(self) -> Tensor:
        return torch.from_numpy(np.array(self.moved())).view(PLATE, PLATE)


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
