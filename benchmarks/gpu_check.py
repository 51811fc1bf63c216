"""One command for whoever has a CUDA GPU: `make gpu-check`, or, installed with the extras, `python -m benchmarks.gpu_check`.

It runs, each in processes of its own and for so many seconds at most:

1. `table`: times, first calls, noise, the share of kernels and memory beside Mitsuba's `cuda_ad_rgb`
   (`benchmarks.gpu_table`);
2. `kernels`: the tests marked `gpu` but for the longest: single kernels, the Cornell box, all jumps, forward mode, a loop;
3. `figures`: passes by themselves, over our own CPU (`benchmarks.device_figures --device cuda`), and `plugins`: the other
   tests: every plugin and parameter in double precision.

Where a card is lent for ten minutes at a time, `--part 1`, `--part 2` and `--part 3` are three calls; the first two take a
quarter of an hour together, and tell most.

What they print is saved in a folder as it comes, and after each of them all figures, with the names of the card and of the
versions, in `report.json`. A step that fails or takes too long does not keep the next from running. Without a GPU it says
so, runs nothing and ends with status 1.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import platform
import signal
import subprocess
import sys
import threading
import time
from importlib import metadata, util
from pathlib import Path
from typing import NamedTuple

import torch

NO_GPU = """No CUDA GPU was found, so nothing was run and no report was saved.
torch {version} {build}.
This command is for machines with a card of NVIDIA's, its driver, and a torch that was built for CUDA. There it runs the
tests marked `gpu` and the benchmark beside Mitsuba's cuda_ad_rgb, and saves both. What can be checked without a card is part
of `make test`, and `python -m benchmarks.ptx` lists registers and spills of all kernels."""
PACKAGES = ("torch", "llvmlite", "cuda-bindings", "warp-lang", "mitsuba")


LONGEST = "every_plugin"  # tests by name; each compiles kernels of its own
WORKERS = 16  # processes of these, at most
TABLE = 520  # seconds after which the table is as it is
PATIENCE = 10  # seconds that a step has to end by itself, once its time is over


class Step(NamedTuple):
    """A part of the check."""

    name: str
    command: tuple[str, ...]
    limit: float  # seconds
    part: int
    needs: str | None = None  # a module, without which it is left out
    side_by_side: bool = False  # in processes of their own, each of one thread on the CPU


def steps(folder: Path, quick: bool) -> list[Step]:
    """What is run."""
    several = bool(util.find_spec("xdist"))
    workers = ("-n", str(min(WORKERS, os.cpu_count() or 1))) if several else ()
    tests = (sys.executable, "-m", "pytest", "-m", "gpu", "tests/gpu", "-rf", "--tb=short", "--durations=5", *workers)
    table, figures = (sys.executable, "-m", "benchmarks.gpu_table"), (sys.executable, "-m", "benchmarks.device_figures")
    size = ("--quick", "--rounds", "2") if quick else ()
    large = size or ("--resolution", "512", "--spp", "64", "--rounds", "3")
    return [Step("table", (*table, "--device", "cuda", "--seconds", f"{TABLE}", *size, "--json", str(folder / "table.json")),
                 TABLE + 30, 1),
            Step("kernels", (*tests, "-k", f"not {LONGEST}"), 200, 2, side_by_side=several),
            Step("figures", (*figures, "--device", "cuda", *large, "--json", str(folder / "figures.json")), 250, 3),
            Step("plugins", (*tests, "-k", LONGEST), 400, 3, side_by_side=several)]


def saved(folder: Path) -> dict[str, list]:
    """The figures that the steps have saved, by the name of the step."""
    return {path.stem: json.loads(path.read_text()) for path in sorted(folder.glob("*.json")) if path.stem != "report"}


def machine() -> dict[str, str]:
    """The card and the versions."""
    found = {"card": torch.cuda.get_device_name(), "CUDA of torch": str(torch.version.cuda),
             "python": platform.python_version()}
    for package in PACKAGES:
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            found[package] = "not installed"
    return found


def run(step: Step, folder: Path) -> str:
    """Runs a step, shows and saves what it prints, line by line with the seconds, and returns how it ended."""
    if step.needs and not util.find_spec(step.needs):
        print(f"== {step.name}: left out, since {step.needs} is not installed", flush=True)
        return f"left out: {step.needs} is not installed"
    print(f"== {step.name}, {step.limit:.0f} s at most: {' '.join(step.command)}", flush=True)
    start, threads = time.monotonic(), {"OMP_NUM_THREADS": "1"} if step.side_by_side else {}
    with open(folder / f"{step.name}.txt", "w", encoding="utf-8") as log, subprocess.Popen(
            step.command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace",
            start_new_session=True, env={**os.environ, "PYTHONUNBUFFERED": "1", **threads}) as process:
        late = threading.Event()
        stop = threading.Timer(step.limit, end, [process, late])
        stop.start()
        for line in process.stdout:
            print(f"{time.monotonic() - start:6.1f}  {line}", end="", flush=True)
            log.write(line)
            log.flush()
        code = process.wait()
        stop.cancel()
    took = f"in {time.monotonic() - start:.0f} s"
    if late.is_set():
        return f"stopped after its {took[3:]}"
    return f"passed {took}" if code == 0 else f"failed with status {code} {took}"


def end(process: subprocess.Popen, late: threading.Event) -> None:
    """Interrupts a process and those that it has started, so that pytest says what has failed so far; then ends them."""
    late.set()
    for how, patience in ((signal.SIGINT, PATIENCE), (signal.SIGKILL, None)):
        with contextlib.suppress(ProcessLookupError, subprocess.TimeoutExpired):
            os.killpg(process.pid, how)
            process.wait(patience)


def main(arguments: list[str] | None = None) -> int:
    """Runs the check; the status is 0 if every step that was run has passed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--folder", type=Path, default=Path("runs/gpu-check"), help="where a folder with the report is made")
    parser.add_argument("--quick", action="store_true", help="tiny images, to see that it works")
    parser.add_argument("--only", nargs="+", metavar="STEP", choices=[step.name for step in steps(Path(), False)],
                        help="these steps: %(choices)s")
    parser.add_argument("--part", type=int, choices=sorted({step.part for step in steps(Path(), False)}),
                        help="the steps of this number")
    parser.add_argument("--patience", type=float, default=1.0, help="times the seconds that each step may take")
    options = parser.parse_args(arguments)
    if not torch.cuda.is_available():
        build = f"was built for CUDA {torch.version.cuda}" if torch.version.cuda else "was built for the CPU alone"
        print(NO_GPU.format(version=torch.__version__, build=build))
        return 1
    folder = options.folder / time.strftime("%Y-%m-%d-%H%M%S")
    folder.mkdir(parents=True)
    about, status = machine(), {}
    print("\n".join(f"{key}: {value}" for key, value in about.items()), flush=True)
    for step in steps(folder, options.quick):
        if (not options.only or step.name in options.only) and options.part in (None, step.part):
            status[step.name] = run(step._replace(limit=step.limit * options.patience), folder)
            print(f"== {step.name} {status[step.name]}", flush=True)
            report = json.dumps({"machine": about, "status": status, **saved(folder)}, indent=1)
            (folder / "report.json").write_text(report)
    print(f"saved in {folder}; " + ", ".join(f"{name}: {how}" for name, how in status.items()))
    return int(any(not how.startswith(("passed", "left out")) for how in status.values()))


if __name__ == "__main__":
    raise SystemExit(main())
