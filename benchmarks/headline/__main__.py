"""Time to equal error: ``python -m benchmarks.headline`` (needs mitsuba==3.9.1, cholespy, trimesh and LLVM).

Five tasks of inverse rendering, each with this renderer and with Mitsuba (``llvm_ad_rgb``): the same scene, targets (by
Mitsuba), first guess, size of images, loss (mean squared error), and Adam with the same rates. Mitsuba has
the integrators of its tutorials, and where they guide samples of edges, which takes time, it also runs without guiding.
The scenes name no sampler, so that each has its own, ours points of low discrepancy and Mitsuba independent samples; Mitsuba
also runs with its ``multijitter``, the quietest of its samplers for gradients. Both run with the task's samples a pixel and
with a quarter of them: quick steps are noisier. Of all runs of a renderer those that are soonest count.
This renderer has its defaults: ``renderer(seed=step)``, image and derivative by samples of their own, as Mitsuba's.

Ours and one way of running Mitsuba step by turns within one process, after steps that compile and count for nothing but the
column "first step"; a process holds one scene of each, since others would cost Mitsuba time. Recorded are the seconds of
every step and the error of what was found. The common error is 1.5 times that at the end of our best or Mitsuba's,
whichever is greater; the figure is the ratio of the seconds after which the errors stay below it, medians of the seeds. Who
takes longer than ``--seconds`` for a run is stopped. With ``--gauss-newton`` this renderer also runs by that optimiser, in
as many steps, each of several renderings, whose samples it chooses itself. Figures of tasks that were measured before are
kept in the folder of ``--out`` and shown again, so that one can measure task by task.
"""

from __future__ import annotations

import argparse
import gc
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from rich.console import Console
from rich.progress import Progress

from benchmarks.headline.chart import panel, write_chart
from benchmarks.headline.loops import MitsubaLoop, OurGaussNewton, OurLoop
from benchmarks.headline.race import OURS, Curve, Loop, Outcome, common_error, fastest, is_ours, outcome, race
from benchmarks.headline.task import Task
from benchmarks.headline.tasks import TASKS
from benchmarks.peers import mitsuba_for
from benchmarks.scenes import QUICK

FEWER = (1, 4)  # by how many times fewer samples than the task's a renderer runs
SAMPLERS = {None: "", "multijitter": ", multijitter"}  # of Mitsuba's sensors; None: its default
WARM_UP = 2
MOST_NUMBERS = 2000  # for Gauss-Newton
HEADER = """\
| task | renderer | step, ms | first step, s | error, start | at the end | common | seconds to it | ours / Mitsuba's |
|---|---|---|---|---|---|---|---|---|"""


def measure(options: argparse.Namespace) -> dict:
    """Curves of one task, ours and those of one way of running Mitsuba, in this process."""
    mi = mitsuba_for("cpu")
    with tempfile.TemporaryDirectory() as folder, Progress(console=Console(stderr=True), transient=True) as progress:
        task = TASKS[options.only](Path(folder))
        integrator, sampler, samples = ways(task)[options.against]
        if options.quick:
            task = task._replace(setting=QUICK._replace(max_depth=task.setting.max_depth), steps=2)
        targets = task.targets(mi, options.target_samples)
        task = task._replace(setting=task.setting._replace(spp=samples))
        ours, theirs = (task.sampled(Path(folder), kind) for kind in (None, sampler))

        def loops(seed: int) -> dict[str, Loop]:
            found: dict[str, Loop] = {our_name(samples): OurLoop(ours, targets, seed)}
            if options.gauss_newton:
                by_squares = OurGaussNewton(ours, targets, seed)
                if by_squares.size <= MOST_NUMBERS:
                    found[f"{OURS}, Gauss-Newton, from {samples} a pixel"] = by_squares
            return found | {options.against: MitsubaLoop(theirs, integrator, mi, targets, seed)}

        first = warm_up(loops(seed=0))
        shown = progress.add_task(f"{task.title}: {options.against}", total=options.seeds * task.steps)
        runs: dict[str, list[Curve]] = {name: [] for name in first}
        for seed in range(options.seeds):
            # Mitsuba's kernels contain what every scene in memory has, so that one that is still there takes its time.
            gc.collect()
            found = race(loops(seed), task.error, task.steps, options.seconds, lambda: progress.advance(shown))
            for name, curve in found.items():
                runs[name].append(curve)
    return {"task": options.only, "title": task.title, "measure": task.measure, "first": first,
            "runs": {name: [curve._asdict() for curve in curves] for name, curves in runs.items()}}


def ways(task: Task) -> dict[str, tuple[str, str | None, int]]:
    """The ways in which Mitsuba runs a task: integrator, type of sampler, samples a pixel, by what the table calls them."""
    return {f"{integrator}{said}, {samples} a pixel": (integrator, sampler, samples)
            for samples in samples_tried(task) for integrator in task.integrators for sampler, said in SAMPLERS.items()}


def samples_tried(task: Task) -> list[int]:
    """The samples a pixel with which both renderers run a task."""
    return sorted({max(1, task.setting.spp // fewer) for fewer in FEWER}, reverse=True)


def our_name(samples: int) -> str:
    """What the table calls runs of ours with so many samples a pixel."""
    return f"{OURS}, {samples} a pixel"


def warm_up(loops: dict[str, Loop]) -> dict[str, float]:
    """Steps that count for nothing; the seconds of the first of each loop."""
    first = {name: loop.step(10**5) for name, loop in loops.items()}
    for loop in loops.values():
        for number in range(1, WARM_UP):
            loop.step(10**5 + number)
    return first


def in_own_processes(name: str, options: argparse.Namespace) -> dict | None:
    """`measure` against each way of running Mitsuba, together; None if one has failed and said why."""
    with tempfile.TemporaryDirectory() as folder:
        found = [in_own_process(name, against, options) for against in ways(TASKS[name](Path(folder)))]
    return joined([one for one in found if one is not None]) if all(found) else None


def in_own_process(name: str, against: str, options: argparse.Namespace) -> dict | None:
    """`measure` in a new process, whose home folder holds no kernels of Mitsuba; None if it has failed and said why."""
    command = [sys.executable, "-m", "benchmarks.headline", "--only", name, "--against", against, "--seeds",
               str(options.seeds), "--seconds", str(options.seconds), "--target-samples", str(options.target_samples),
               *["--quick"] * options.quick, *["--gauss-newton"] * options.gauss_newton]
    with tempfile.TemporaryDirectory() as home:
        done = subprocess.run(command, stdout=subprocess.PIPE, text=True,
                              env={**os.environ, "HOME": home, "RADBP_KERNEL_CACHE": "off"})
    return None if done.returncode else json.loads(done.stdout.splitlines()[-1])


def joined(found: list[dict]) -> dict:
    """Races of one task as one: ours has run in each of them, and all its runs count."""
    runs: dict[str, list[dict]] = {}
    for one in found:
        for name, curves in one["runs"].items():
            runs.setdefault(name, []).extend(curves)
    return found[0] | {"first": {name: seconds for one in reversed(found) for name, seconds in one["first"].items()},
                       "runs": runs}


def curves_of(found: dict) -> dict[str, list[Curve]]:
    """The runs of a task, from what its process has printed."""
    return {name: [Curve(**curve) for curve in curves] for name, curves in found["runs"].items()}


def rows(found: dict) -> list[str]:
    """The lines of the table for one task, a renderer each."""
    runs = curves_of(found)
    common = common_error(runs)
    outcomes = {name: outcome(runs[name], common) for name in sorted(runs, key=lambda name: not is_ours(name))}
    mine, theirs = (fastest(each for name, each in outcomes.items() if is_ours(name) == own) for own in (True, False))
    # None, where it is not reached, or no seconds at all, where already the first guess is as good.
    ratio = f"**{mine / theirs:.2f}**" if mine and theirs else "none: not reached by both, or at once"
    return [f"| {'' if number else found['title']} | {name} | {1e3 * each.step:.0f} | {found['first'][name]:.1f} | "
            f"{runs[name][0].errors[0]:.3g} | {ending(each)} | {common:.3g} | "
            f"{'not reached' if each.seconds is None else f'{each.seconds:.2f}'} | {'' if number else ratio} |"
            for number, (name, each) in enumerate(outcomes.items())]


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
    parser.add_argument("--gauss-newton", action="store_true", help="ours also by Gauss-Newton, of 2000 numbers at most")
    parser.add_argument("--quick", action="store_true", help="tiny images and two steps, to see that it works")
    parser.add_argument("--only", choices=TASKS, help=argparse.SUPPRESS)
    parser.add_argument("--against", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.only:
        print(json.dumps(measure(options)))
        return
    options.out.mkdir(parents=True, exist_ok=True)
    failed = []
    for name in options.task:
        found = in_own_processes(name, options)
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
                                                       common_error(runs)) for found in known])
    if failed:
        raise SystemExit(f"failed: {', '.join(failed)}")


if __name__ == "__main__":
    main()
