"""Media beside Mitsuba 3.9.1's: their images, and how long they take; ``python -m benchmarks.media`` (needs mitsuba==3.9.1).

Without flags it renders the rows of `tests/scenes/xml/media.py`, each by both from the same file: a medium, a phase
function, a boundary, a camera, a light, a depth. Mitsuba renders by `volpathmis` in `llvm_ad_rgb`, both without Russian
roulette.

    z        difference of the image's mean in standard errors of both sides, of the colour where it is greatest
    bias     the same, relative, with its standard error
    inside   pixels that differ by no more than chance explains, as in `benchmarks.parity`
    verdict  equal: |z| < 4, and 99.75% of the pixels are inside; else what is known of the reason

``--public`` renders the scenes with media of Mitsuba's test suite, rebuilt (`tests/scenes/xml/public_media.py`), by 868
samples.

``--integrators`` shows Mitsuba's `volpathmis` with and without roulette, beside its `volpath` and us: the means of two
images, of a haze under a sky, and of one in a tinted pane before a lamp.

``--time`` measures three scenes: a ball of glass with a medium under a sky, fog in a room, a cloud of 128^3 cells under a
sky. Both take turns in one process, forward alone and forward with backward (gradients by extinction and albedo; Mitsuba by
`volpathmis` and `prbvolpath`); medians of the rounds, first calls apart. Variances are those of the image, mean over
pixels, and of the gradient, mean over the entries of a parameter, between rounds; equal noise is variance times seconds.
Mitsuba's gradients are not those of differences everywhere (by extinction in the fog, in the cloud where it is empty, by
albedo in the glass): there equal noise compares with a wrong answer. So grids have a figure of cells that are not empty,
too. Run it on an idle machine; more rounds know variances better: ``--rounds 5`` to within a factor of 2.

``--memory`` shows the peak of resident memory of a forward and backward pass through a grid of 256^3 cells, the grid itself
and what building the scene takes included, over the bytes of the grid and its gradient. Each size runs in a process of its
own, after a pass through a tiny grid, which loads what there is to load.

    python -m benchmarks.media --only "sggx"              # rows by parts of their names
    python -m benchmarks.media --public --only homo
    python -m benchmarks.media --time --only cloud --rounds 9
    python -m benchmarks.media --memory 64 128 256
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
import warnings
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import torch

import torch_radbp as rb
from benchmarks.noise import Spread
from benchmarks.parity import ENOUGH, Found, rendered
from benchmarks.peers import Mitsuba, Ours, mitsuba_for
from benchmarks.resident import MIB, peak_of
from benchmarks.scenes import media as timed_scenes
from benchmarks.scenes.description import NO_ROULETTE
from tests.scenes.xml import media, public_media
from tests.scenes.xml.files import Case, Folder

BATCHES, PATHS = 32, 1e6
FARTHEST = 4.0  # standard errors
# Why rows differ, by a part of their names.
REASONS = {"sggx": "Mitsuba's samples other directions than its density says: `benchmarks.media_flakes`"}
INTEGRATORS_OF = (media.Row("grey", "tabphase", "null", "inside", "sky", 64),
                  media.Row("grey", "isotropic", "tinted", "inside", "lamp", 8))
HEADER = "| scene | z | bias | inside | time, ours + Mitsuba's | verdict |\n|---|---|---|---|---|---|"


def row(name: str, found: Found) -> tuple[str, bool]:
    """A line of the table, and whether the two agree."""
    bias, error = found.comparison.bias, found.comparison.bias_error
    z = bias / np.maximum(error, 1e-12)
    worst = int(abs(z).argmax())
    equal = bool(abs(z[worst]) < FARTHEST and found.inside >= ENOUGH)
    reason = next((reason for part, reason in REASONS.items() if part in name), "")
    cells = [name, f"{z[worst]:+.1f}", f"{100 * bias[worst]:+.2f}% +- {100 * error[worst]:.2f}%",
             f"{100 * found.inside:.2f}%", " + ".join(f"{each:.0f} s" for each in found.seconds),
             "equal" if equal else f"**differs** {reason}".strip()]
    return f"| {' | '.join(cells)} |", equal


def table(cases: dict[str, Case], spp: int, batches: int, seed: int) -> None:
    """Renders and compares."""
    print(HEADER, flush=True)
    agree = 0
    for name, case in cases.items():
        line, equal = row(name, rendered(case, spp, batches, seed))
        print(line, flush=True)
        agree += equal
    print(f"{agree} of {len(cases)} agree")


def integrators(row: media.Row, spp: int, batches: int) -> None:
    """Prints the means of one image by Mitsuba's integrators, with and without Russian roulette, and by us."""
    mi, case = mitsuba_for("cpu"), media.case_of(row)
    depth = case.variables["max_depth"]
    print(f"{row}\n")
    with tempfile.TemporaryDirectory() as folder:
        path = case.build(Folder(Path(folder)))
        theirs, ours = mi.load_file(str(path), **case.variables), rb.load(path, **case.variables)
        print("| integrator | rr_depth | mean by colour | standard error |\n|---|---|---|---|")
        for name in ("volpathmis", "volpath", "ours"):
            for rr_depth in (5, NO_ROULETTE):
                if name == "ours":
                    renderer = rb.Renderer(ours, spp=spp, rr_depth=rr_depth)
                    with torch.no_grad():
                        images = [renderer(seed=batch)[0].mean((1, 2)).numpy() for batch in range(batches)]
                else:
                    integrator = mi.load_dict({"type": name, "max_depth": depth, "rr_depth": rr_depth})
                    images = [np.array(mi.render(theirs, integrator=integrator, spp=spp, seed=batch)).mean((0, 1))
                              for batch in range(batches)]
                cells = (np.mean(images, 0), np.std(images, 0, ddof=1) / len(images)**0.5)
                means = " | ".join(" ".join(f"{value:.5f}" for value in cell) for cell in cells)
                print(f"| {name} | {rr_depth} | {means} |", flush=True)


class Side:
    """One renderer on one scene: passes, of which the first is told apart, and the spread of what they give."""

    def __init__(self, forward, both, shown: dict[str, np.ndarray]) -> None:
        self.forward, self.both = forward, both
        self.shown = shown  # by parameter which of its entries are not 0, where some are
        self.seconds: dict[str, list[float]] = {"forward": [], "both": []}
        self.spreads: dict[str, Spread] = {}

    def turn(self, seed: int) -> None:
        """A forward pass, and a forward and backward pass."""
        start = time.perf_counter()
        image = self.forward(seed)
        self.seconds["forward"].append(time.perf_counter() - start)
        self.seconds["both"].append(self.both.run(seed).both)
        if seed:
            for name, value in ({"image": image} | self.both.gradients_found()).items():
                self.spreads.setdefault(name, Spread()).add(value)
                for shown in self.shown.values() if value.ndim == 4 and value.shape[-1] == 1 else ():
                    self.spreads.setdefault(f"{name} where it is not 0", Spread()).add(value.reshape(-1)[shown])

    def median(self, what: str) -> float:
        return statistics.median(self.seconds[what][1:])


def measure(name: str, rounds: int, small: bool) -> None:
    """Prints the lines of one scene."""
    with tempfile.TemporaryDirectory() as folder:
        scene, their_names = timed_scenes.SCENES[name](Folder(Path(folder)), small)
        ours = Ours(scene, compiled=True)
        theirs = Mitsuba(scene._replace(parameters=their_names), "cpu", {"type": "prbvolpath"})
        plain = theirs.using({"type": "volpathmis"}, scene.setting.spp)
        shown = {each: (value.detach() != 0).reshape(-1).numpy() for each, value in ours.parameters.items()
                 if bool((value == 0).any())}
        sides = {"ours": Side(lambda seed: ours.image(scene.setting.spp, seed).numpy(), ours, shown),
                 "Mitsuba": Side(lambda seed: plain.image(scene.setting.spp, seed).numpy(), theirs, shown)}
        for seed in range(rounds + 1):
            for side in sides.values():
                side.turn(seed)
    us, them = sides.values()
    for what in ("forward", "both"):
        ratio = us.median(what) / them.median(what)
        equal = {}
        for (ours_name, mine), (_, other) in zip(us.spreads.items(), them.spreads.items()):
            if (ours_name == "image") == (what == "forward"):
                equal[ours_name] = mine.variance / max(other.variance, 1e-300)
        noise = "; ".join(f"{each}: {value:.2f}, {value * ratio:.2f}" for each, value in equal.items())
        print(f"| {name}, {what} | {us.median(what):.3f} | {them.median(what):.3f} | {ratio:.2f} | "
              f"{us.seconds[what][0]:.1f}, {them.seconds[what][0]:.1f} | {noise} |", flush=True)


def grid_step(cells: int, built: list[rb.Scene]) -> None:
    """Builds a scene with a grid, unless there is one, and renders it forward and backward."""
    if not built:
        data = torch.nn.Parameter(torch.rand(cells, cells, cells, 1))  # which the scene does not copy
        filling = {"type": "heterogeneous", "scale": 10, "sigma_t": {"type": "gridvolume", "data": data}}
        film = {"type": "hdrfilm", "width": 128, "height": 128, "rfilter": {"type": "box"}}
        to_world = torch.tensor([[0.5, 0, 0, 0.5], [0, 0.5, 0, 0.5], [0, 0, 0.5, 0.5], [0, 0, 0, 1]])
        built.append(rb.load_dict({
            "type": "scene", "sky": {"type": "constant"},
            "camera": {"type": "perspective", "fov": 35, "film": film, "to_world": rb.look_at((2, 1, 2), (0.5, 0.5, 0.5))},
            "box": {"type": "cube", "to_world": to_world, "bsdf": {"type": "null"}, "interior": filling}}))
    built[0].zero_grad()
    rb.Renderer(built[0], spp=16, max_depth=16)().mean().backward()


def memory(cells: int) -> None:
    """Prints the line of a grid of `cells`^3, in this process."""
    both = 2 * 4 * cells**3
    grid_step(8, [])
    built: list[rb.Scene] = []
    first = peak_of(lambda: grid_step(cells, built))
    later = peak_of(lambda: grid_step(cells, built))
    print(f"| {cells} | {both / MIB:.0f} | {first / MIB:.0f} | {first / both:.2f} | {later / MIB:.0f} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="parts of names, with semicolons between")
    parser.add_argument("--paths", type=float, default=PATHS, help="of each side, for each image of a row")
    parser.add_argument("--seed", type=int, default=0)
    kinds = parser.add_mutually_exclusive_group()
    kinds.add_argument("--public", action="store_true", help="the scenes of Mitsuba's test suite, rebuilt")
    kinds.add_argument("--integrators", action="store_true", help="the biases of volpathmis")
    kinds.add_argument("--time", action="store_true", help="seconds and noise of three scenes")
    kinds.add_argument("--memory", type=int, nargs="*", metavar="CELLS", help="of a grid, along each axis; 256 by default")
    parser.add_argument("--rounds", type=int, default=5, help="of --time, after the first calls")
    parser.add_argument("--small", action="store_true", help="of --time: tiny images, to see that it works")
    options = parser.parse_args()
    warnings.simplefilter("ignore")

    def chosen(named: dict) -> dict:
        return {name: value for name, value in named.items() if any(part in name for part in options.only.split(";"))}

    if options.memory is not None:
        print("| cells | grid and gradient, MiB | building and first step, MiB | over both | next step, MiB more |\n"
              "|---|---|---|---|---|", flush=True)
        for cells in options.memory or [256]:
            process = get_context("spawn").Process(target=memory, args=(cells,))
            process.start()
            process.join()
        return
    if options.time:
        print("| scene | ours, s | Mitsuba, s | ratio | first calls, s | variance of ours over Mitsuba's, equal noise |\n"
              "|---|---|---|---|---|---|", flush=True)
        for name in chosen(timed_scenes.SCENES):
            measure(name, options.rounds, options.small)
        return
    spp = max(1, round(options.paths / (BATCHES * media.SIZE["width"] * media.SIZE["height"])))
    if options.integrators:
        for shown in INTEGRATORS_OF:
            integrators(shown, spp, 2 * BATCHES)
    elif options.public:
        public = {name: public_media.case_of(name) for name in public_media.SCENES}
        table(chosen(public), public_media.SPP, public_media.BATCHES, options.seed)
    else:
        table(chosen({str(each): media.case_of(each) for each in media.rows()}), spp, BATCHES, options.seed)


if __name__ == "__main__":
    main()
