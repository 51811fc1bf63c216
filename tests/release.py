"""Builds what a release has, the wheel and the source archive, and tries both in empty environments.

    make release                                                     # into dist/; every Python here, oldest and newest torch
    python -m tests.release --python python3.12 --torch 2.6.0        # one of them; either may be given several times

An environment has nothing but what pip installs for the wheel: a script must find a colour there, and `radbp doctor` nothing
wrong; then the source archive takes the wheel's place, and the script runs once more. Each takes minutes and gigabytes of
torch, and is deleted at its end. Where pip takes its packages from is pip's to know, by its own settings.
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
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).parents[1]
NEWEST = "newest"
OLDEST_PYTHON = re.search(r'python_requires=">=3\.(\d+)"', (ROOT / "setup.py").read_text(encoding="utf-8"))[1]
OLDEST_TORCH = re.search(r'"torch>=([\d.]+)"', (ROOT / "setup.py").read_text(encoding="utf-8"))[1]
NO_WHEEL = "No matching distribution found for torch"  # as pip says it of a torch that is not made for a Python

# A user's first loop: the wall's colour, by a camera and a lamp of the script's own.
SCRIPT = """
import torch
import torch_radbp as rb

scene = rb.load_dict({
    "type": "scene",
    "camera": {"type": "perspective", "fov": 40.0, "to_world": rb.look_at([0, 0, 4], [0, 0, 0], [0, 1, 0]),
               "film": {"type": "hdrfilm", "width": 16, "height": 16}},
    "lamp": {"type": "point", "position": [0.0, 0.0, 3.0], "intensity": {"type": "rgb", "value": [20.0, 20.0, 20.0]}},
    "wall": {"type": "rectangle", "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.6, 0.3, 0.2]}}},
})
target = rb.render(scene, spp=16, max_depth=3, seed=1000).detach()
colour = scene.get_parameter("wall.bsdf.reflectance.value")
colour.data.fill_(0.4)
colour.requires_grad_()
optimizer = torch.optim.Adam([colour], lr=0.05)
renderer = rb.Renderer(scene, spp=4, max_depth=3)
for step in range(40):
    optimizer.zero_grad()
    loss = rb.losses.two_buffer_l2(renderer(seed=2 * step), renderer(seed=2 * step + 1), target)
    loss.backward()
    optimizer.step()
print(rb.__file__)
print(*colour.tolist())
"""
VERSIONS = """
import numpy, platform, torch
print(f"{platform.python_version()}, torch {torch.__version__}, numpy {numpy.__version__}")
"""
COLOUR, WITHIN = (0.6, 0.3, 0.2), 0.03  # what the script must find: 40 steps from noisy images


class Failed(Exception):
    """A command that has not ended well, with what it said."""


def run(*command: object, **settings) -> str:
    """Standard output of a command that must end well."""
    done = subprocess.run([*map(str, command)], capture_output=True, text=True, **settings)
    if done.returncode:
        raise Failed(done.stdout + done.stderr)
    return done.stdout


def outside(folder: Path) -> dict[str, str]:
    """The variables of an environment in which nothing leads to this tree, and nothing is compiled yet."""
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONPATH" and not name.startswith("RADBP_")}
    return {**kept, "RADBP_KERNEL_CACHE": str(folder / "kernels")}


def build_wheel(folder: Path, work: Path) -> Path:
    """The wheel of this tree, in `folder`; nothing but `work` is written to beside."""
    run(sys.executable, "setup.py", "-q", "egg_info", "--egg-base", work, "build", "--build-base", work / "build",
        "bdist_wheel", "--dist-dir", folder, cwd=ROOT)
    path, = folder.glob("*.whl")
    return path


def build_archive(folder: Path, work: Path) -> Path:
    """The source archive of this tree, in `folder`; nothing but `work` is written to beside."""
    run(sys.executable, "setup.py", "-q", "egg_info", "--egg-base", work, "sdist", "--dist-dir", folder, cwd=ROOT)
    path, = folder.glob("*.tar.gz")
    return path


def programs_of(environment: Path) -> Path:
    """The folder of the programs of a virtual environment."""
    return environment / ("Scripts" if os.name == "nt" else "bin")


def check_found(said: str, inside: Path) -> None:
    """Raises Failed unless the script used the package of `inside` and found the colour."""
    where, colour = said.splitlines()
    off = max(abs(float(value) - expected) for value, expected in zip(colour.split(), COLOUR))
    if not Path(where).resolve().is_relative_to(inside.resolve()) or not off < WITHIN:
        raise Failed(f"{where} found {colour}, expected {COLOUR} within {WITHIN}, in {inside}")


def pythons_here() -> list[str]:
    """One interpreter of each version that the package takes, of those on the path and of pyenv's."""
    named = [shutil.which(f"python3.{minor}") for minor in range(int(OLDEST_PYTHON), 30)]
    of_pyenv = sorted((Path.home() / ".pyenv" / "versions").glob("3.*/bin/python"))
    found: dict[int, str] = {}
    for path in [sys.executable, *filter(None, named), *of_pyenv]:
        said = subprocess.run([path, "-c", "import sys; print(sys.version_info.minor)"], capture_output=True, text=True)
        if not said.returncode and int(said.stdout) >= int(OLDEST_PYTHON):  # a shim may name what is not there
            found.setdefault(int(said.stdout), str(path))
    return [path for _, path in sorted(found.items())]


def tried(python: str, torch: str, wheel: Path, archive: Path) -> str:
    """What became of wheel and archive in an empty environment, in words.

    Raises:
        Failed: if something went wrong; with what was said.
    """
    start = time.perf_counter()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "work").mkdir()
        (folder / "script.py").write_text(SCRIPT, encoding="utf-8")
        inside = {"cwd": folder / "work", "env": outside(folder)}
        run(python, "-m", "venv", folder / "environment")
        programs = programs_of(folder / "environment")
        pip = programs / "python", "-m", "pip", "install", "-q"
        try:
            run(*pip, "torch" if torch == NEWEST else f"torch=={torch}", wheel, **inside)
        except Failed as error:
            if NO_WHEEL in str(error):
                return f"there is no torch {torch} for it"
            raise
        versions = run(programs / "python", "-c", VERSIONS, **inside).strip()
        check_found(run(programs / "python", folder / "script.py", **inside), folder / "environment")
        run(programs / "radbp", "doctor", **inside)
        run(*pip, "--force-reinstall", "--no-deps", archive, **inside)
        check_found(run(programs / "python", folder / "script.py", **inside), folder / "environment")
    return f"Python {versions}: wheel and source archive work, {time.perf_counter() - start:.0f} s"


def main(arguments: Sequence[str] | None = None) -> int:
    """Builds, tries all, and returns the number of environments in which something went wrong."""
    parser = argparse.ArgumentParser(prog="python -m tests.release", description=__doc__.splitlines()[0])
    parser.add_argument("--python", action="append", help="an interpreter; default: one of each version that is here")
    parser.add_argument("--torch", action="append", help=f"a version, or {NEWEST}; default: {OLDEST_TORCH}.0 and {NEWEST}")
    chosen = parser.parse_args(arguments)
    dist, wrong = ROOT / "dist", 0
    shutil.rmtree(dist, ignore_errors=True)
    with tempfile.TemporaryDirectory() as work:
        wheel, archive = build_wheel(dist, Path(work)), build_archive(dist, Path(work))
    print(f"built {wheel.relative_to(ROOT)} and {archive.relative_to(ROOT)}")
    for python in chosen.python or pythons_here():
        for torch in chosen.torch or (f"{OLDEST_TORCH}.0", NEWEST):
            try:
                print(f"{python}, torch {torch}: {tried(python, torch, wheel, archive)}", flush=True)
            except Failed as error:
                wrong += 1
                print(f"{python}, torch {torch}: FAILED\n{error}", flush=True)
    return wrong


if __name__ == "__main__":
    sys.exit(main())
