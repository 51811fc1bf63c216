"""What jumps cost and how noisy they are: ``python -m benchmarks.boundary`` (needs mitsuba==3.9.1 and LLVM).

Four scenes in which a mesh moves, box filter: a ball over a plane under a rectangular lamp, a detailed mesh under an
environment map, a body before a wall on which its shadow falls, and a shadow by itself. The gradient of a fixed cotangent of
the image is taken in six directions of the mesh's vertices. This renderer, with all terms, and Mitsuba's `prb_projective`
(`llvm_ad_rgb`), by its defaults and, without guiding, by three ways to split its samples between interior, primary and
shadow, take turns within one process, forward and backward. The error of a renderer is the variance of its gradient plus the
square of its bias, both over the squared size of the reference, which many passes of both give; it counts times the seconds
of a pass. A scene takes as long as `--minutes` says: what slow machines have no time for are rounds, whose number is told,
and the standard error of each ratio with it, that of the variances.

``--cost`` gives instead the time of all boundary terms over that of the interior, forward and backward, and ``--variance``
the variance of what the term "shadow" adds to derivative images, for the scenes of `tests.scenes.shadows`.
"""

from __future__ import annotations

import argparse
import json
import math
import subprocess
import sys

from benchmarks.boundary import cost, error, variance
from benchmarks.boundary.projected import DEFAULT, OURS
from benchmarks.boundary.scenes import SCENES
from benchmarks.scenes.description import Setting
from tests.scenes.shadows import SHADOWS

REFERENCES = ["| scene | gradients | difference | by chance | largest z |", "|---|---|---|---|---|"]
RENDERERS = ["", "| scene | renderer | passes | ms | variance | squared bias | error x time | ours over it |",
             "|---|---|---|---|---|---|---|---|"]


def rows(found: dict) -> list[str]:
    """Lines of the tables for one scene: how references agree, and each renderer."""
    lines = REFERENCES + [f"| {found['scene']} | {what} | {one['off']:.4f} | {one['by_chance']:.4f} | {one['z']:.1f} |"
                          for what, one in found["references"].items()] + RENDERERS
    costs = {who: (one["variance"] + one["bias"]) * one["seconds"] for who, one in found["renderers"].items()}
    best = min((who for who in costs if who not in (OURS, DEFAULT)), key=costs.get)
    unsure = {who: one["spread"] * one["seconds"] / costs[who] for who, one in found["renderers"].items()}
    for who, one in found["renderers"].items():
        ratio = ""
        if who != OURS:
            value = costs[OURS] / costs[who]
            ratio = f"{value:.3f} +- {value * math.hypot(unsure[who], unsure[OURS]):.3f}"
            ratio += " (best split)" if who == best else ""
        numbers = (f"{one['passes']} | {1e3 * one['seconds']:.0f} | {one['variance']:.2e} | {one['bias']:.2e} | "
                   f"{costs[who]:.2e}")
        lines.append(f"| {found['scene']} | {who} | {numbers} | {ratio} |")
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--cost", action="store_true", help="time of boundary terms over that of the interior")
    what.add_argument("--variance", action="store_true", help="variances of the shadow term's derivative images")
    parser.add_argument("--scene", nargs="+", choices=[*SCENES, *SHADOWS], help="default: all")
    parser.add_argument("--resolution", type=int, default=128, help="pixels a side")
    parser.add_argument("--spp", type=int, default=16)
    parser.add_argument("--rounds", type=int, default=12, help="passes of each")
    parser.add_argument("--references", type=int, default=8, help="passes with more samples, for the reference")
    parser.add_argument("--finer", type=int, default=16, help="how many times as many samples these have")
    parser.add_argument("--differences", type=int, default=0, help="of finite differences beside the reference")
    parser.add_argument("--minutes", type=float, default=8.0, help="for each scene, after which no pass begins")
    parser.add_argument("--only", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    setting = Setting(options.resolution, options.spp, 0)
    if options.variance:
        variance.print_table(options.scene or list(SHADOWS))
    elif options.only:
        name, effort = options.scene[0], error.Effort(*(getattr(options, number) for number in error.Effort._fields))
        found = cost.measure(name, setting, effort.rounds) if options.cost else error.measure(name, setting, effort)
        print(json.dumps(found))
    else:
        if options.cost:
            print(cost.HEADER, flush=True)
        for name in options.scene or SCENES:
            found = in_own_process(name, options)
            lines = [f"| {name} | failed |"] if found is None else [cost.row(found)] if options.cost else rows(found)
            print("\n".join(lines), flush=True)


def in_own_process(name: str, options: argparse.Namespace) -> dict | None:
    """What is measured of a scene; None: it failed."""
    command = [sys.executable, "-m", "benchmarks.boundary", "--only", "--scene", name, *["--cost"] * options.cost]
    for number in ("resolution", "spp", "rounds", "references", "finer", "differences", "minutes"):
        command += [f"--{number}", str(getattr(options, number))]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True)
    return None if done.returncode else json.loads(done.stdout.splitlines()[-1])


if __name__ == "__main__":
    main()
