"""How long a new process takes to its first image: ``python -m benchmarks.first_image``.

Each scene of `benchmarks.scenes` is rendered by processes of its own, whose compiled code is kept in a folder that is
empty at first: what `import`, loading and the first image take, beside the fastest image of the same process. The first
process compiles, the others find what it has left. The ratio is that of the whole to import, loading and the fastest image.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

COLUMNS = ("scene", "process", "import s", "load s", "first image s", "later image s", "ratio")


def measure(name: str, gradients: bool) -> dict[str, float]:
    """Seconds of this process, which has imported nothing yet."""
    start = time.perf_counter()
    import torch

    import torch_radbp as rb

    rb.Renderer, rb.load  # noqa: B018 what users name is imported when it is named
    imported = time.perf_counter() - start
    from benchmarks.peers import Ours
    from benchmarks.scenes import SCENES

    make, setting = SCENES[name]
    with tempfile.TemporaryDirectory() as folder:
        scene = make(Path(folder), setting)
        start = time.perf_counter()
        ours = Ours(scene, compiled=True)
        loaded = time.perf_counter() - start

    def image(seed: int) -> float:
        start = time.perf_counter()
        if gradients:
            ours.run(seed)
        else:
            with torch.no_grad():
                ours.renderer(seed=seed)
        return time.perf_counter() - start

    first = image(0)
    return {"import": imported, "load": loaded, "first": first, "later": min(image(seed) for seed in (1, 2, 3))}


def in_own_process(name: str, gradients: bool, folder: str) -> dict[str, float]:
    command = [sys.executable, "-m", "benchmarks.first_image", "--only", name, *["--gradients"] * gradients]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True,
                          env={**os.environ, "RADBP_KERNEL_CACHE": folder})
    return json.loads(done.stdout.splitlines()[-1])


def row(name: str, process: str, found: list[dict[str, float]]) -> str:
    """The line of the table, by medians."""
    seconds = {key: statistics.median(each[key] for each in found) for key in found[0]}
    before = [each["import"] + each["load"] for each in found]
    ratio = statistics.median((start + each["first"]) / (start + each["later"]) for start, each in zip(before, found))
    cells = [name, process, *(f"{seconds[key]:.2f}" for key in ("import", "load", "first", "later")), f"{ratio:.2f}"]
    return f"| {' | '.join(cells)} |"


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--gradients", action="store_true", help="forward and backward passes instead of images")
    parser.add_argument("--rounds", type=int, default=5, help="processes after the first (default 5)")
    parser.add_argument("--only", help="one scene, in this process; prints JSON")
    options = parser.parse_args()
    if options.only:
        print(json.dumps(measure(options.only, options.gradients)))
        return
    from benchmarks.scenes import SCENES

    print(f"| {' | '.join(COLUMNS)} |\n|{'---|' * len(COLUMNS)}")
    for name in SCENES:
        with tempfile.TemporaryDirectory() as folder:
            found = [in_own_process(name, options.gradients, folder) for _ in range(1 + options.rounds)]
        print(row(name, "first", found[:1]))
        print(row(name, "others", found[1:]), flush=True)


if __name__ == "__main__":
    main()
