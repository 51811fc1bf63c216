"""Our images against Mitsuba 3.9.1's, scene by scene: ``python -m benchmarks.parity`` (needs mitsuba==3.9.1 and LLVM).

Every row of `tests/scenes/xml/matrix.py` at two depths, rendered by both from the same file, by Mitsuba in `llvm_ad_rgb`.
Each side renders independent batches, of which Welch's t gives a p-value for each pixel and channel; the level 0.05 is
Sidak-corrected for their number. A row of the table holds

    inside  pixels whose three channels pass; a scene passes with 99.75% of them
    z       greatest difference of a pixel in standard errors of both sides
    p       of the whole comparison, that is of pixels, blocks of 8 x 8, the mean, and the uniformity of all p-values; small
            without any bias in the rows of a beam, where the rare bright paths of eight batches follow no normal law
            (either renderer against itself: 1e-11 to 0.02 at depth 6)
    bias    of the mean of the image, relative, greatest of the channels; with its standard error

The sheet shows ours, Mitsuba's, and the difference of each pixel in standard errors: blue where ours is darker, red where
it is brighter, white where they are equal, darkest at 5. ``--only "mask,principled_glass"`` picks scenes by part of their
names.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from PIL import Image

import torch_radbp as rb
from benchmarks.peers import mitsuba_for
from benchmarks.sheet import write_sheet
from tests.peer.agreement import Comparison, Estimate, compare, estimate, p_values
from tests.peer.mitsuba_images import render
from tests.scenes.xml.files import Case, Folder
from tests.scenes.xml.matrix import cases
from torch_radbp.formats.image import linear_to_srgb
from torch_radbp.training.false_colour import signed_colour

SIZE = {"width": 64, "height": 48}
BATCHES = 32
# Of wide filters, where Mitsuba divides by the weights that a pixel has got, a bias by 1 / samples of a batch; and of its
# particle tracer, whose few bright pixels are far from normal.
LONG_BATCHES = 8
LEVEL, ENOUGH = 0.05, 0.9975
DARKEST = 5.0  # standard errors
PEER_SEED = 500_000
ZOOM, COLUMNS = 2, 3


class Found(NamedTuple):
    """Two images and what their comparison says."""

    ours: Estimate
    theirs: Estimate
    comparison: Comparison
    seconds: tuple[float, float]

    @property
    def inside(self) -> float:
        """The share of pixels that differ by no more than chance explains."""
        p = p_values(self.ours, self.theirs, reach=3)
        return float((p > 1 - (1 - LEVEL) ** (1 / p.size)).all(-1).mean())

    @property
    def z(self) -> np.ndarray:
        """(H, W) difference in standard errors, of the channel where it is greatest."""
        error = np.hypot(self.ours.error, self.theirs.error)
        z = (self.ours.mean - self.theirs.mean) / np.maximum(error, 1e-12 + 1e-5 * self.theirs.mean)
        return np.take_along_axis(z, abs(z).argmax(-1)[..., None], -1)[..., 0]

    @property
    def passes(self) -> bool:
        return self.inside >= ENOUGH


def compared(case: Case, paths: float, seed: int) -> Found:
    """Renders a case on both sides, by as many paths as asked for."""
    batches = BATCHES if case.thin == 1 and case.peer_integrator != "ptracer" else LONG_BATCHES
    return rendered(case, max(1, round(paths / (batches * SIZE["width"] * SIZE["height"]))), batches, seed)


def rendered(case: Case, spp: int, batches: int, seed: int) -> Found:
    """Renders batches of a case on both sides."""
    with tempfile.TemporaryDirectory() as folder:
        path, starts = case.build(Folder(Path(folder))), [time.perf_counter()]
        renderer = rb.Renderer(rb.load(path, **case.variables), spp=spp)
        with torch.no_grad():
            ours = [renderer(seed=seed + batch)[0].permute(1, 2, 0).numpy() for batch in range(batches)]
        starts.append(time.perf_counter())
        theirs = render(path, case, spp, batches, first_seed=PEER_SEED + seed, mi=mitsuba_for("cpu"))
        starts.append(time.perf_counter())
    a, b = (estimate(side, spp) for side in (ours, theirs))
    return Found(a["pixels"], b["pixels"], compare(a, b), tuple(np.diff(starts)))


def panels(found: Found) -> list[Image.Image]:
    """Ours, theirs, and the differences in standard errors."""
    bright = max(float(np.quantile(found.theirs.mean, 0.98)), 1e-6)
    images = [linear_to_srgb(torch.from_numpy(side.mean / bright)).clamp(0, 1) for side in (found.ours, found.theirs)]
    images.append(signed_colour(torch.from_numpy(found.z).float(), DARKEST).permute(1, 2, 0).clamp(0, 1) ** (1 / 2.2))
    size = ZOOM * SIZE["width"], ZOOM * SIZE["height"]
    return [Image.fromarray((255 * image.numpy() + 0.5).astype(np.uint8)).resize(size, Image.Resampling.NEAREST)
            for image in images]


def row(name: str, depth: int, found: Found) -> str:
    """A line of the table."""
    bias, error = found.comparison.bias, found.comparison.bias_error
    worst = int(abs(bias).argmax())
    seconds = " + ".join(f"{each:.0f} s" for each in found.seconds)
    cells = [name, str(depth), f"{100 * found.inside:.2f}%", f"{abs(found.z).max():.1f}", f"{found.comparison.p:.2g}",
             f"{100 * bias[worst]:+.2f}% +- {100 * error[worst]:.2f}%", seconds, "" if found.passes else "**no**"]
    return f"| {' | '.join(cells)} |"


HEADER = """| scene | depth | inside | z | p | bias | time, ours + Mitsuba's | passes |
|---|---|---|---|---|---|---|---|"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="parts of names, with commas between")
    parser.add_argument("--depths", type=int, nargs="+", default=[2, 6])
    parser.add_argument("--paths", type=float, default=2e6, help="of each side, for each image")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--sheet", type=Path, default=Path("runs/parity.png"))
    options = parser.parse_args()
    chosen = [(name.removeprefix("matrix_"), depth, case) for depth in options.depths
              for name, case in cases(SIZE | {"max_depth": depth}).items()
              if any(part in name for part in options.only.split(","))]
    print(HEADER, flush=True)
    pictures, passed = [], 0
    for name, depth, case in chosen:
        found = compared(case, options.paths, options.seed)
        print(row(name, depth, found), flush=True)
        pictures.append((f"{name}, {depth}", panels(found)))
        write_sheet(options.sheet, pictures, COLUMNS)
        passed += found.passes
    print(f"{passed} of {len(chosen)} pass; pictures: {options.sheet}")


if __name__ == "__main__":
    main()
