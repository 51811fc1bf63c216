"""One command for whoever has a CUDA GPU: `make gpu-check`, or, installed with the extras, `python -m benchmarks.gpu_check`.

It runs the tests that need a GPU (those marked `gpu`); then forward and backward passes by themselves: first call, samples
a second, over our own CPU, peak of memory beside the prediction (`benchmarks.device_figures --device cuda`); then the same
beside Mitsuba's `cuda_ad_rgb` (`benchmarks.versus_mitsuba --device cuda`). What they print is saved in a folder, with all
figures and the names of the card and of the versions in `report.json`. A step that fails does not keep the next from
running. Without a GPU it says so, runs nothing and ends with status 1.
"""

from __future__ import annotations

import argparse
import json
import platform
import subprocess
import sys
import time
from importlib import metadata
from pathlib import Path
from typing import NamedTuple

import torch

NO_GPU = """No CUDA GPU was found, so nothing was run and no report was saved.
torch {version} {build}.
This command is for machines with a card of NVIDIA's, its driver, and a torch that was built for CUDA. There it runs the
tests marked `gpu` and the benchmark beside Mitsuba's cuda_ad_rgb, and saves both. What can be checked without a card is part
of `make test`, and `python -m benchmarks.ptx` lists registers and spills of all kernels."""
PACKAGES = ("torch", "llvmlite", "cuda-bindings", "warp-lang", "mitsuba")


class Step(NamedTuple):
    """A part of the check."""

    name: str
    command: tuple[str, ...]


def steps(folder: Path, quick: bool) -> list[Step]:
    """What is run."""
    tests = (sys.executable, "-m", "pytest", "-m", "gpu", "tests/gpu", "-rf")
    size = ("--quick", "--rounds", "2") if quick else ("--resolution", "512", "--spp", "64")
    measured = [Step(name, (sys.executable, "-m", f"benchmarks.{module}", "--device", "cuda", *size, "--json",
                            str(folder / f"{name}.json")))
                for name, module in (("figures", "device_figures"), ("times", "versus_mitsuba"))]
    return [Step("tests", tests), *measured]


def saved(folder: Path) -> dict[str, list]:
    """The figures that the steps have saved, by the name of the step."""
    return {path.stem: json.loads(path.read_text()) for path in sorted(folder.glob("*.json"))}


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


def run(step: Step, folder: Path) -> int:
    """Runs a step, shows and saves what it prints, and returns its status."""
    print(f"== {step.name}: {' '.join(step.command)}", flush=True)
    with open(folder / f"{step.name}.txt", "w", encoding="utf-8") as log, subprocess.Popen(
            step.command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as process:
        for line in process.stdout:
            print(line, end="", flush=True)
            log.write(line)
    return process.returncode


def main(arguments: list[str] | None = None) -> int:
    """Runs the check; the status is 0 if every step's is."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--folder", type=Path, default=Path("runs/gpu-check"), help="where a folder with the report is made")
    parser.add_argument("--quick", action="store_true", help="tiny images, to see that it works")
    options = parser.parse_args(arguments)
    if not torch.cuda.is_available():
        build = f"was built for CUDA {torch.version.cuda}" if torch.version.cuda else "was built for the CPU alone"
        print(NO_GPU.format(version=torch.__version__, build=build))
        return 1
    folder = options.folder / time.strftime("%Y-%m-%d-%H%M%S")
    folder.mkdir(parents=True)
    about = machine()
    print("\n".join(f"{key}: {value}" for key, value in about.items()))
    status = {step.name: run(step, folder) for step in steps(folder, options.quick)}
    (folder / "report.json").write_text(json.dumps({"machine": about, "status": status, **saved(folder)}, indent=1))
    print(f"saved in {folder}; " + ", ".join(f"{name}: {'passed' if code == 0 else f'failed with status {code}'}"
                                             for name, code in status.items()))
    return max(status.values())


if __name__ == "__main__":
    raise SystemExit(main())
