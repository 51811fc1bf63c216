"""The time of boundary terms over that of the interior."""

from __future__ import annotations

import statistics
import tempfile
import warnings
from pathlib import Path

import torch_radbp as rb
from benchmarks.boundary.scenes import SCENES, VERTICES
from benchmarks.primary import WARM_UP, steps, took
from benchmarks.scenes.description import Setting, without_samplers

TERMS = {"interior": ["interior"], "primary": ["interior", "primary"], "all": ["interior", "primary", "shadow"]}
HEADER = """| scene | interior, ms | all terms, ms | boundary terms over interior | of these primary | shadow |
|---|---|---|---|---|---|"""


def measure(name: str, setting: Setting, rounds: int) -> dict:
    """Milliseconds of a pass forward and backward with some of the terms, medians."""
    make, depth = SCENES[name]
    warnings.simplefilter("ignore", rb.SilhouetteWarning)  # of what has fewer terms
    with tempfile.TemporaryDirectory() as home:
        scene = without_samplers(make(Path(home), setting._replace(max_depth=depth)).scene, Path(home))
        works = steps(scene, (VERTICES,), TERMS)
    times = {what: [] for what in works}
    for seed in range(rounds + WARM_UP):
        for what, work in works.items():
            times[what].append(took(work, seed))
    return {"scene": name} | {what: statistics.median(own[WARM_UP:]) for what, own in times.items()}


def row(found: dict) -> str:
    interior, primary, both = (found[what] for what in TERMS)
    cells = [f"{interior:.1f}", f"{both:.1f}", f"{both / interior - 1:.2f}", f"{primary / interior - 1:.2f}",
             f"{(both - primary) / interior:.2f}"]
    return f"| {found['scene']} | {' | '.join(cells)} |"
