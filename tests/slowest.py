"""How long each test takes: what `make test` keeps in `runs/test_durations.json`, the longest first.

    python -m tests.slowest [NUMBER]     # prints so many of the slowest tests, and of files by the sums of their tests
"""

from __future__ import annotations

import argparse
import json
from collections import defaultdict
from pathlib import Path

import pytest

FILE = Path("runs/test_durations.json")


class Durations:
    """A plugin of pytest that writes the seconds of every test, with set-up and tear-down, into a file of JSON.

    Workers report to the process that started them, which alone needs it.
    """

    def __init__(self, file: Path):
        self.file = file
        self.seconds: defaultdict[str, float] = defaultdict(float)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self.seconds[report.nodeid] += report.duration

    def pytest_sessionfinish(self) -> None:
        slowest_first = sorted(self.seconds.items(), key=lambda item: -item[1])
        self.file.parent.mkdir(parents=True, exist_ok=True)
        self.file.write_text(json.dumps({name: round(seconds, 3) for name, seconds in slowest_first}, indent=0) + "\n")


def table(seconds: dict[str, float], number: int) -> str:
    """So many of the slowest tests, and the files that take the longest, with the sums of their tests."""
    files: defaultdict[str, float] = defaultdict(float)
    for name, own in seconds.items():
        files[name.partition("::")[0]] += own
    total = sum(seconds.values())
    parts = [f"{total:.0f} s in {len(seconds)} tests of {len(files)} files"]
    for found in (seconds, files):
        slowest = sorted(found.items(), key=lambda item: -item[1])[:number]
        parts.append("\n".join(f"{own:8.2f} s  {100 * own / total:4.1f} %  {name}" for name, own in slowest))
    return "\n\n".join(parts)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.slowest", description=__doc__.splitlines()[0])
    parser.add_argument("number", type=int, nargs="?", default=100, help="of tests, and of files; 100 if not given")
    parser.add_argument("--file", type=Path, default=FILE, help="that pytest kept by --keep-durations")
    options = parser.parse_args()
    print(table(json.loads(options.file.read_text()), options.number))


if __name__ == "__main__":
    main()
