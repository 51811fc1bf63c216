"""`python -m tests.fuzz --minutes 60 --seed 0`: mutants of scene files, meshes, images and recipes, loaded and rendered.

Each mutant is a function of the seed, its family and its number. Faults are saved, the summary is printed, and the exit code
is 1 if there is any.
"""

from __future__ import annotations

import argparse
import random
import shutil
import sys
import tempfile
import time
from collections import Counter, defaultdict
from pathlib import Path

from tests.fuzz.corpus import FAMILIES, Seed, build_corpus
from tests.fuzz.mutation import mutate
from tests.fuzz.worker import Worker


def write_mutant(corpus: dict[str, list[Seed]], family: str, seed: int, number: int) -> Path:
    """Writes a mutant beside the files that it refers to."""
    source = random.Random(f"{seed} {family} {number}")
    original = source.choice(corpus[family])
    others = [each.content for each in corpus[family]]
    path = original.folder / f"mutant{FAMILIES[family]}"
    path.write_bytes(mutate(family, source, original.content, others))
    return path


class Tally:
    """What became of the mutants."""

    def __init__(self, folder: Path):
        self.folder = folder
        self.outcomes: dict[str, Counter] = defaultdict(Counter)
        self.faults: dict[tuple[str, str], list[str]] = defaultdict(list)  # family and kind -> files
        self.unrendered: dict[tuple[str, str], list[str]] = defaultdict(list)

    def add(self, family: str, number: int, seed: int, path: Path, verdict: list[str]) -> None:
        """Counts a verdict, and keeps the file of a fault, or of what loads and does not render; of each kind a few."""
        outcome, kind, detail = verdict
        self.outcomes[family][outcome if outcome == "fault" else f"{outcome} {kind}".strip()] += 1
        if outcome in ("fault", "refused to render"):
            files = (self.faults if outcome == "fault" else self.unrendered)[family, kind]
            name = f"{family}_{seed}_{number}"
            files.append(name)
            if len(files) <= 3:
                self.folder.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(path, self.folder / f"{name}{path.suffix}")
                (self.folder / f"{name}.txt").write_text(f"{path.parent}\n{outcome}: {kind}\n{detail}\n")
                print(f"{outcome}: {name}: {kind}", flush=True)

    def __str__(self) -> str:
        lines = []
        for family, counts in self.outcomes.items():
            lines.append(f"{family}: {counts.total()} cases")
            lines += [f"    {count:7d} {outcome}" for outcome, count in counts.most_common()]
        lines.append(f"{sum(map(len, self.faults.values()))} faults of {len(self.faults)} kinds")
        lines += [f"    {len(files):7d} {family}: {kind} ({self.folder / files[0]}.*)"
                  for (family, kind), files in sorted(self.faults.items())]
        return "\n".join(lines)


def main() -> int:
    """Runs the fuzzer."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--minutes", type=float, default=1.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--families", nargs="+", choices=FAMILIES, default=list(FAMILIES))
    parser.add_argument("--out", type=Path, default=Path("fuzz_faults"), help="folder for the files of faults")
    parser.add_argument("--number", type=int, help="judge only the mutants of this number")
    options = parser.parse_args()
    tally, worker, end = Tally(options.out), Worker(), time.monotonic() + 60 * options.minutes
    report, number = time.monotonic() + 300, options.number or 0
    with tempfile.TemporaryDirectory() as root:
        corpus = build_corpus(Path(root))
        while time.monotonic() < end:
            for family in options.families:
                path = write_mutant(corpus, family, options.seed, number)
                tally.add(family, number, options.seed, path, worker.judge(family, path))
            if time.monotonic() > report:
                print(tally, flush=True)
                report = time.monotonic() + 300
            if options.number is not None:
                break
            number += 1
        worker.close()
    print(f"seed {options.seed}, {options.minutes:g} minutes")
    print(tally)
    return 1 if tally.faults else 0


if __name__ == "__main__":
    sys.exit(main())
