"""Runs recipes, and writes their times into the table of training/README.md and their pictures for the gallery:

    python -m benchmarks.recipe_times                  # all of them, on a machine that does nothing else
    python -m benchmarks.recipe_times sky point_light --folder runs/recipes

Seconds are those of the whole command in a process of its own, for which nothing has been compiled yet. The picture of a
recipe shows its first target: before, the target, after. Runs stay in the folder; stdout.txt is what a command printed.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from PIL import Image

from torch_radbp.training.commands.bundled import bundled_recipes
from torch_radbp.training.recovery.run_folder import RunFolder

ROOT = Path(__file__).parents[1]
TABLE = ROOT / "training" / "README.md"
PICTURES = ROOT / "assets" / "pictures" / "gallery"
HEIGHT, GAP = 192, 6


def timed(name: str, run: Path) -> float:
    """Seconds that `radbp optimize` takes for a recipe, whose run is a new folder."""
    shutil.rmtree(run, ignore_errors=True)
    with tempfile.TemporaryDirectory() as cache:
        start = time.perf_counter()
        done = subprocess.run([sys.executable, "-m", "torch_radbp.training.cli", "optimize", name, "--out", run], check=True,
                              env=os.environ | {"RADBP_KERNEL_CACHE": cache}, capture_output=True, text=True)
        seconds = time.perf_counter() - start
    (run / "stdout.txt").write_text(done.stdout, encoding="utf-8")
    return seconds


def with_seconds(table: str, seconds: dict[str, float]) -> str:
    """A text with the last cells of its table's rows of recipes, by name, rewritten.

    Raises:
        ValueError: if a recipe has no row.
    """
    for name, value in seconds.items():
        shown = f"{value:.1f}" if value < 10 else f"{value:.0f}"
        table, rows = re.subn(rf"^(\| `{name}\.toml` \|.*\| )[^|]*( \|)$", rf"\g<1>{shown}\2", table, flags=re.MULTILINE)
        if rows != 1:
            raise ValueError(f"{name}.toml must have one row, found {rows}")
    return table


def strip(run: Path) -> Image.Image:
    """The first target of a run beside each other: before, target, after."""
    folder = RunFolder(run)
    sensor = folder.load_summary()["images"][0]["sensor"]
    images = [Image.open(folder.image_path(sensor, role)).convert("RGB") for role in ("before", "target", "after")]
    width = HEIGHT * images[0].width // images[0].height
    picture = Image.new("RGBA", (3 * width + 2 * GAP, HEIGHT))
    for place, image in enumerate(images):
        picture.paste(image.resize((width, HEIGHT), Image.Resampling.BICUBIC), (place * (width + GAP), 0))
    return picture


def main() -> None:
    """Runs recipes, and rewrites their rows and pictures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", help="recipes; none: all")
    parser.add_argument("--folder", type=Path, default=Path("runs/recipes"))
    options = parser.parse_args()
    PICTURES.mkdir(exist_ok=True)
    for name in options.names or bundled_recipes():
        run = options.folder / name
        seconds = timed(name, run)
        TABLE.write_text(with_seconds(TABLE.read_text(encoding="utf-8"), {name: seconds}), encoding="utf-8")
        strip(run).save(PICTURES / f"{name}.webp", quality=85)
        print((run / "stdout.txt").read_text(encoding="utf-8"), f"{name}: {seconds:.1f} s", sep="\n", flush=True)


if __name__ == "__main__":
    main()
