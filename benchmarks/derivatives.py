"""Derivatives of moving scenes against finite differences, in numbers and pictures: ``python -m benchmarks.derivatives``.

Every scene of `tests/derivatives/` (`moving_scenes.py`, `inner_jumps.py`, `shadow_scenes.py`) is rendered by finite
differences, and by forward mode with every sampling that gives the whole derivative, with samples of their own, until the
noise is below the target or the rounds are used up. A row of the table holds

    error   mean over pixels and channels of |JVP - D| / max(|D|, 0.2 S), D the finite differences, S its 99.5% quantile
    noise   what of it the standard errors explain alone: the same with sqrt(2 / pi) standard errors in place of |JVP - D|
    z       (JVP - D) projected on three cotangents, in standard errors: ones, the normalised derivative image, a smooth
            random field; an asterisk where it is off by more than 3 standard errors and 2% of what nothing cancels in
    shows   the bias that would be noticed: 6 standard errors of the projection on the derivative image
    VJP     greatest |<w, JVP> - <VJP(w), d>| relative to <|w|, |JVP|>, same samples

``--only "plane turned,lens"`` picks scenes by part of their names. The sheet shows differences, then each sampling.
"""

from __future__ import annotations

import argparse
import math
import time
from pathlib import Path

import torch
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from benchmarks.sheet import derivative_panels, write_sheet
from tests.derivatives.in_expectation import Effort, Estimate
from tests.scenes.inner_jumps import INNER_JUMPS
from tests.scenes.moving import SCENES
from tests.scenes.shadows import SHADOWS
from torch_radbp.check.outcome import GradientCheck, uncertainty
from torch_radbp.check.statistics import BRIGHTEST, FLOOR, quantile

HEADINGS = ("scene", "sampling", "spp", "error", "noise", "z ones", "z derivative", "z random", "shows", "VJP",
            "verdict")


def noise(result: GradientCheck) -> float:
    """The mean relative error that the standard errors explain."""
    difference = result.comparison.difference.abs()
    size = FLOOR * quantile(difference, BRIGHTEST)
    return float((math.sqrt(2 / math.pi) * result.comparison.standard_error / torch.maximum(difference, size)).mean())


def row(name: str, sampling: str, result: GradientCheck) -> str:
    """A line of the table."""
    cells = [name, sampling, str(result.spp), f"{result.comparison.pixels.mean_relative_error:.3f}", f"{noise(result):.3f}"]
    for p in result.comparison.projections:
        outside = abs(p.jvp - p.difference) > 3 * p.standard_error + 0.02 * p.scale
        cells.append(f"{p.z:+.1f} ({p.relative_error:+.1%}){' *' if outside else ''}")
    worst = max(p.backward_error for p in result.comparison.projections)
    shows = 6 * uncertainty(result.comparison.projections[1])
    return "| " + " | ".join([*cells, f"{shows:.1%}", f"{worst:.0e}", result.verdict]) + " |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--spp", type=int, default=64, help="samples per pixel of a batch in a round")
    parser.add_argument("--rounds", type=int, default=16, help="at most")
    parser.add_argument("--noise", type=float, default=0.025, help="stop a scene when it is below this")
    parser.add_argument("--batches", type=int, default=16)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="parts of names, with commas between")
    parser.add_argument("--sheet", type=Path, default=Path("runs/derivatives.png"))
    options = parser.parse_args()
    scenes, parts = SCENES | INNER_JUMPS | SHADOWS, options.only.split(",")
    chosen = {name: moving for name, moving in scenes.items() if any(part in name for part in parts)}
    panels = []
    with Progress(TextColumn("{task.description}"), BarColumn(), TextColumn("{task.completed}/{task.total}"),
                  TimeElapsedColumn(), transient=True) as progress:
        bar = progress.add_task("", total=len(chosen) * options.rounds)
        progress.console.print("| " + " | ".join(HEADINGS) + " |\n|" + "---|" * len(HEADINGS), soft_wrap=True)
        for number, (name, moving) in enumerate(chosen.items()):
            progress.update(bar, description=name)
            start = time.perf_counter()
            estimate = Estimate(moving, Effort(options.spp, options.batches, options.seed))
            for done in range(1, options.rounds + 1):
                estimate.add_round()
                found = estimate.checks()
                progress.update(bar, completed=number * options.rounds + done)
                if all(noise(result) <= options.noise for result in found.values()):
                    break
            for sampling, result in found.items():
                progress.console.print(row(name, sampling, result), soft_wrap=True, highlight=False)
            progress.update(bar, completed=(number + 1) * options.rounds,
                            description=f"{name}: {time.perf_counter() - start:.0f} s")
            panels.append((f"{name}: differences, {', '.join(found)}", derivative_panels(found)))
            write_sheet(options.sheet, panels)
    print(f"pictures: {options.sheet}")


if __name__ == "__main__":
    main()
