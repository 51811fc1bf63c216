"""Time to equal error: ``python -m benchmarks.headline`` (needs mitsuba==3.9.1, cholespy, trimesh and LLVM).

Five tasks of inverse rendering, each with this renderer and with Mitsuba (``llvm_ad_rgb``): the same scene, targets (by
Mitsuba), first guess, size of images, samples a pixel, loss (mean squared error), and Adam with the same rates. Mitsuba has
the integrators of its tutorials, and where they guide samples of edges, which takes time, it also runs without guiding.
The scenes name no sampler, so that each has its own, ours points of low discrepancy and Mitsuba independent samples; Mitsuba
also runs with its ``multijitter``, the quietest of its samplers for gradients, and whichever is sooner counts.
This renderer has its defaults: ``renderer(seed=step)``, image and derivative by samples of their own, as Mitsuba's.

They step by turns within one process, one for each task, after steps that compile and count for nothing but the column
"first step". Recorded are the seconds of every step and the error of what was found. The common error is 1.5 times that at
the end of ours, or of Mitsuba's best, whichever is greater; the figure is the ratio of the seconds after which the errors
stay below it, medians of the seeds. Who takes longer than ``--seconds`` for a run is stopped. Figures of tasks that were
measured before are kept in the folder of ``--out`` and shown again, so that one can measure task by task.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from rich.console import Console
from rich.progress import Progress

from benchmarks.headline.chart import panel, write_chart
from benchmarks.headline.loops import MitsubaLoop, OurLoop
from benchmarks.headline.race import Curve, Outcome, common_error, fastest, outcome, race
from benchmarks.headline.tasks import TASKS
from benchmarks.peers import mitsuba_for
from benchmarks.scenes import QUICK

OURS = "ours"
SAMPLERS = {None: "", "multijitter": ", multijitter"}  # of Mitsuba's sensors; None: its default
WARM_UP = 2
HEADER = """\
| task | renderer | step, ms | first step, s | error, start | at the end | common | seconds to it | ours / Mitsuba's |
|---|---|---|---|---|---|---|---|---|"""


def measure(options: argparse.Namespace) -> dict:
    """Curves of one task, in this process."""
    mi = mitsuba_for("cpu")
    with tempfile.TemporaryDirectory() as folder, Progress(console=Console(stderr=True), transient=True) as progress:
        task = TASKS[options.only](Path(folder))
        if options.quick:
            task = task._replace(setting=QUICK._replace(max_depth=task.setting.max_depth), steps=2)
        targets = task.targets(mi, options.target_samples)
        sampled = {sampler: task.sampled(Path(folder), sampler) for sampler in SAMPLERS}
        theirs = {f"{name}{said}": (sampled[sampler], name)
                  for name in task.integrators for sampler, said in SAMPLERS.items()}
        runs: dict[str, list[Curve]] = {name: [] for name in (OURS, *theirs)}
        first = {}
        shown = progress.add_task(task.title, total=options.seeds * task.steps)
        for seed in range(options.seeds):
            def loops(seed: int = seed) -> dict:
                return {OURS: OurLoop(sampled[None], targets, seed),
                        **{name: MitsubaLoop(*run, mi, targets, seed) for name, run in theirs.items()}}

            if seed == 0:
                warm = loops()
                first = {name: loop.step(10**5) for name, loop in warm.items()}
                for loop in warm.values():
                    for number in range(1, WARM_UP):
                        loop.step(10**5 + number)
            found = race(loops(), task.error, task.steps, options.seconds, lambda: progress.advance(shown))
            for name, curve in found.items():
                runs[name].append(curve)
    return {"task": options.only, "title": task.title, "measure": task.measure, "first": first,
            "runs": {name: [curve._asdict() for curve in curves] for name, curves in runs.items()}}


def in_own_process(name: str, options: argparse.Namespace) -> dict | None:
    """`measure` in a new process, whose home folder holds no kernels of Mitsuba; None if it has failed and said why."""
    command = [sys.executable, "-m", "benchmarks.headline", "--only", name, "--seeds", str(options.seeds), "--seconds",
               str(options.seconds), "--target-samples", str(options.target_samples), *["--quick"] * options.quick]
    with tempfile.TemporaryDirectory() as home:
        done = subprocess.run(command, stdout=subprocess.PIPE, text=True,
                              env={**os.environ, "HOME": home, "RADBP_KERNEL_CACHE": "off"})
    return None if done.returncode else json.loads(done.stdout.splitlines()[-1])


def curves_of(found: dict) -> dict[str, list[Curve]]:
    """The runs of a task, from what its process has printed."""
    return {name: [Curve(**curve) for curve in curves] for name, curves in found["runs"].items()}


def rows(found: dict) -> list[str]:
    """The lines of the table for one task, a renderer each."""
    runs = curves_of(found)
    common = common_error(runs, OURS)
    outcomes = {name: outcome(curves, common) for name, curves in runs.items()}
    theirs = fastest(each for name, each in outcomes.items() if name != OURS)
    mine = outcomes[OURS].seconds
    # None, where it is not reached, or no seconds at all, where already the first guess is as good.
    ratio = f"**{mine / theirs:.2f}**" if mine and theirs else "none: not reached by both, or at once"
    return [f"| {found['title'] if name == OURS else ''} | {name} | {1e3 * each.step:.0f} | {found['first'][name]:.1f} | "
            f"{runs[name][0].errors[0]:.3g} | {ending(each)} | {common:.3g} | "
            f"{'not reached' if each.seconds is None else f'{each.seconds:.2f}'} | {ratio if name == OURS else ''} |"
            for name, each in outcomes.items()]


def ending(found: Outcome) -> str:
    """The error at the end, and what is to be said of it."""
    stopped = "" if found.complete else ", stopped"
    return f"{found.final:.3g}{stopped or ('' if found.converged else ', not converged')}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--task", choices=TASKS, nargs="+", default=list(TASKS))
    parser.add_argument("--seeds", type=int, default=3, help="runs of each renderer")
    parser.add_argument("--seconds", type=float, default=60.0, help="that a run may take, of the steps of one renderer")
    parser.add_argument("--target-samples", type=int, default=512, help="a pixel of the targets")
    parser.add_argument("--out", type=Path, default=Path("runs/headline"), help="folder of figures, table and chart")
    parser.add_argument("--quick", action="store_true", help="tiny images and two steps, to see that it works")
    parser.add_argument("--only", choices=TASKS, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.only:
        print(json.dumps(measure(options)))
        return
    options.out.mkdir(parents=True, exist_ok=True)
    failed = []
    for name in options.task:
        found = in_own_process(name, options)
        if found is None:
            failed.append(name)
        else:
            (options.out / f"{name}.json").write_text(json.dumps(found))
    known = [json.loads(path.read_text()) for name in TASKS if (path := options.out / f"{name}.json").exists()]
    if known:
        table = "\n".join([HEADER, *(row for found in known for row in rows(found))])
        (options.out / "table.md").write_text(table + "\n")
        print(table)
        write_chart(options.out / "curves.png", [panel(found["title"], found["measure"], runs := curves_of(found),
                                                       common_error(runs, OURS)) for found in known])
    if failed:
        raise SystemExit(f"failed: {', '.join(failed)}")


if __name__ == "__main__":
    main()
