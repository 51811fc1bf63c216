"""A process that judges mutants, so that one that hangs or crashes takes only it along.

`python -m tests.fuzz.worker` reads lines "family path" and answers each with a line of JSON. It is killed by SIGPROF when a
mutant takes more than its processor time; memory beyond its limit is refused by the system.
"""

from __future__ import annotations

import json
import os
import resource
import select
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

SECONDS = 60  # of processor time for a mutant
WALL_SECONDS = 900  # for one that waits
MEMORY = 4 << 30  # bytes of addresses beyond what the libraries take


class Worker:
    """The other end: starts the process, asks it, and starts a new one when it dies.

    Args:
        command: what to run.
        wall_seconds: how long to wait for an answer.
    """

    def __init__(self, command: list[str] | None = None, wall_seconds: float = WALL_SECONDS):
        self.command = command or [sys.executable, "-m", "tests.fuzz.worker"]
        self.wall_seconds = wall_seconds
        self.process: subprocess.Popen | None = None

    def judge(self, family: str, path: Path) -> list[str]:
        """[outcome, kind, detail] of a mutant, as `judge.judge` gives them, or a fault if the process ends or hangs."""
        if self.process is None or self.process.poll() is not None:
            self.errors = tempfile.TemporaryFile()
            self.process = subprocess.Popen(self.command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self.errors)
        try:
            self.process.stdin.write(f"{family} {path}\n".encode())
            self.process.stdin.flush()
        except BrokenPipeError:
            pass  # the answer will be missing, too
        ready, _, _ = select.select([self.process.stdout], [], [], self.wall_seconds)
        answer = self.process.stdout.readline() if ready else b""
        if answer:
            return json.loads(answer)
        if not ready:
            self.process.kill()
        code = self.process.wait()
        self.errors.seek(0)
        said = self.errors.read()[-3000:].decode("utf-8", "replace")
        if not ready:
            return ["fault", f"hangs for {self.wall_seconds} s", said]
        name = signal.Signals(-code).name if code < 0 else f"exit code {code}"
        meaning = f": more than {SECONDS} s of processor time" if name == "SIGPROF" else ""
        return ["fault", f"process ended by {name}{meaning}", said]

    def close(self) -> None:
        """Ends the process."""
        if self.process is not None:
            self.process.kill()
            self.process.wait()


def main() -> None:
    """Judges what standard input names."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # libraries print there
    import warnings

    import torch

    from tests.fuzz.judge import judge, render_small
    from tests.io.documents import scene_dict
    from torch_radbp import load_dict

    warnings.simplefilter("ignore")
    torch.set_num_threads(1)
    render_small(load_dict(scene_dict(ball={"type": "sphere"})))  # loads the libraries that only a rendering needs
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + MEMORY,) * 2)
    for line in sys.stdin:
        family, _, path = line.rstrip("\n").partition(" ")
        signal.setitimer(signal.ITIMER_PROF, SECONDS)
        verdict = judge(family, Path(path))
        signal.setitimer(signal.ITIMER_PROF, 0)
        print(json.dumps(verdict), file=answers, flush=True)


if __name__ == "__main__":
    main()
