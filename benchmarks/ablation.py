"""What derivatives of moving scenes lack without the parts that make them right: ``python -m benchmarks.ablation``.

Bars: |<w, JVP> - <w, D>| over the sum of |<w, D>| in tiles, D the finite differences, w the normalised derivative image;
whiskers: two standard errors.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from PIL import Image, ImageDraw
from rich.progress import track

from tests.derivatives.ablation import SCENES, WITHOUT, without
from tests.derivatives.in_expectation import Effort, Estimate
from tests.scenes.moving import SCENES as MOVING
from torch_radbp.check.statistics import Projection

COLOURS = ("#1b7837", "#5aae61", "#c2a5cf", "#762a83")
WIDTH, LEFT, TOP, BAR, GAP = 760, 190, 56, 13, 18  # pixels


def measure(name: str, what: str, effort: Effort, rounds: int) -> Projection:
    """The derivative of a scene, projected on the normalised derivative image."""
    with without(*WITHOUT[what]):
        estimate = Estimate(MOVING[name]._replace(samplings=("hybrid",)), effort)
        for _ in range(rounds):
            estimate.add_round()
        return estimate.checks()["hybrid"].comparison.projections[1]


def draw(path: Path, found: dict[str, dict[str, Projection]]) -> None:
    """Writes the chart as PNG."""
    height = TOP + len(found) * (len(WITHOUT) * BAR + GAP) + 30
    largest = max(abs(p.relative_error) for projections in found.values() for p in projections.values())
    unit = (WIDTH - LEFT - 70) / max(largest, 1e-9)
    chart = Image.new("RGB", (WIDTH, height), "white")
    pen = ImageDraw.Draw(chart)
    for k, (what, colour) in enumerate(zip(WITHOUT, COLOURS)):
        x, y = LEFT + k % 2 * 260, 10 + k // 2 * 18
        pen.rectangle((x, y, x + 12, y + 10), fill=colour)
        pen.text((x + 18, y - 1), "with all parts" if what == "nothing" else f"without {what}", fill="black")
    y = TOP
    for name, projections in found.items():
        pen.text((10, y + 2 * BAR - 8), name, fill="black")
        for (_, p), colour in zip(projections.items(), COLOURS):
            size, spread = abs(p.relative_error), 2 * p.standard_error / p.scale
            pen.rectangle((LEFT, y, LEFT + unit * size, y + BAR - 3), fill=colour)
            middle = y + (BAR - 3) / 2
            pen.line((LEFT + unit * max(size - spread, 0), middle, LEFT + unit * (size + spread), middle), fill="black")
            pen.text((LEFT + unit * (size + spread) + 6, y - 1), f"{size:.1%}", fill="black")
            y += BAR
        y += GAP
    pen.text((LEFT, y - 4), "bias of the derivative image, relative; line: two standard errors", fill="black")
    path.parent.mkdir(parents=True, exist_ok=True)
    chart.save(path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--spp", type=int, default=64, help="samples per pixel of a batch in a round")
    parser.add_argument("--rounds", type=int, default=8)
    parser.add_argument("--batches", type=int, default=8)
    parser.add_argument("--picture", type=Path, default=Path("assets/pictures/ablation.png"))
    options = parser.parse_args()
    found: dict[str, dict[str, Projection]] = {name: {} for name in SCENES}
    for name, what in track([(name, what) for name in SCENES for what in WITHOUT], "scenes"):
        found[name][what] = measure(name, what, Effort(options.spp, options.batches), options.rounds)
    for name, projections in found.items():
        for what, p in projections.items():
            print(f"{name:28} without {what:24} off by {p.relative_error:+7.2%}, {p.z:+7.1f} standard errors")
    draw(options.picture, found)
    print(f"picture: {options.picture}")


if __name__ == "__main__":
    main()
