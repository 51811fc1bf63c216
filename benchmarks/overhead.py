"""What a small rendering takes: ``python -m benchmarks.overhead``.

The scenes of `versus_mitsuba` with 32 x 32 pixels and one sample a pixel, forward and backward, compiled, with the gradients
and the depth of the table there. There is little to compute, so that what is measured is mostly Python between the stages.
As in training, the parameters change a little before every pass. One process for each scene; after some passes that compile
and warm up, medians in milliseconds of wall time, and of the CPU time of all threads. `bounces` is the depth of the deepest
path.

With ``--beside FOLDER`` another checkout of this repository takes turns with this one, pass by pass, so that both see the
same neighbours on the machine.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from benchmarks.peers import Ours, Pass
from benchmarks.scenes import SCENES

RESOLUTION, SPP = 32, 1
WARM_UP = 8  # passes
HERE = Path(__file__).resolve().parents[1]


def serve(name: str) -> None:
    """Makes one pass for each line of standard input, and writes its times to standard output."""
    make, setting = SCENES[name]
    with tempfile.TemporaryDirectory() as folder:
        ours = Ours(make(Path(folder), setting._replace(resolution=RESOLUTION, spp=SPP)), compiled=True)
    for seed, _ in enumerate(sys.stdin):
        print(json.dumps(ours.run(seed)._asdict()), flush=True)


@contextmanager
def server(checkout: Path, name: str) -> Iterator[subprocess.Popen]:
    """A process that serves passes of one scene with the code of a checkout."""
    command = [sys.executable, __file__, "--serve", name]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=checkout,
                               env={**os.environ, "PYTHONPATH": str(checkout)})
    try:
        yield process
    finally:
        process.stdin.close()
        process.wait()


def one_pass(process: subprocess.Popen) -> Pass:
    """The times of one pass."""
    process.stdin.write("\n")
    process.stdin.flush()
    return Pass(**json.loads(process.stdout.readline()))


def measure(name: str, checkouts: list[Path], rounds: int) -> list[list[Pass]]:
    """The passes of one scene, for each checkout."""
    if len(checkouts) > 1:
        with server(checkouts[0], name) as first, server(checkouts[1], name) as second:
            turns = [[one_pass(process) for process in (first, second)] for _ in range(WARM_UP + rounds)]
    else:
        with server(checkouts[0], name) as only:
            turns = [[one_pass(only)] for _ in range(WARM_UP + rounds)]
    return [list(passes) for passes in zip(*turns[WARM_UP:])]


def row(name: str, label: str, passes: list[Pass]) -> str:
    """The line of the table for the passes of one scene with one checkout."""
    def median(what) -> str:
        return f"{1e3 * statistics.median(map(what, passes)):8.2f}"

    columns = (median(lambda p: p.forward), median(lambda p: p.backward), median(lambda p: p.both), median(lambda p: p.cpu))
    return f"{name:20} {label:12} {' '.join(columns)}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", choices=SCENES, nargs="+", default=list(SCENES))
    parser.add_argument("--rounds", type=int, default=50)
    parser.add_argument("--beside", type=Path, metavar="FOLDER", help="another checkout to compare with")
    parser.add_argument("--serve", choices=SCENES, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.serve:
        serve(options.serve)
        return
    checkouts = {"this": HERE} | ({"the other": options.beside.resolve()} if options.beside else {})
    print(f"{'':33} {'forward':>8} {'backward':>8} {'both':>8} {'CPU':>8}", flush=True)
    for name in options.scene:
        for label, passes in zip(checkouts, measure(name, list(checkouts.values()), options.rounds)):
            print(row(name, label, passes), flush=True)


if __name__ == "__main__":
    main()
