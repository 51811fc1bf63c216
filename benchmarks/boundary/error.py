"""The mean squared error of a gradient, and the time that it takes, with either renderer."""

from __future__ import annotations

import statistics
import tempfile
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.progress import track

from benchmarks.boundary.projected import DEFAULT, GUIDED, MANY, OURS, SEEDS, differences, mitsubas, ours, splits
from benchmarks.boundary.scenes import SCENES
from benchmarks.peers import Mitsuba
from benchmarks.scenes.description import Setting

WARM_UP = 2
AGREES = 3.5  # standard errors
SLOW, TIMES_LESS = (DEFAULT, MANY), 3  # guided passes take seconds: there are so many times less of them
FEWEST, FEWEST_SLOW = 4, 3  # passes, however long they take: for the reference, and of a slow renderer
OF_REFERENCES = 0.4  # share of the time that references may take


class Effort(NamedTuple):
    """How much is rendered of a scene, at most."""

    rounds: int  # of each renderer, in turns; fewer of the slow ones
    references: int  # passes with more samples, of both
    finer: int  # how many times as many samples these have
    differences: int  # of finite differences in each direction
    minutes: float  # after which no pass begins, but for the fewest that tell anything


class Mean(NamedTuple):
    """The mean of independent gradients."""

    value: np.ndarray  # (K,)
    variance: np.ndarray  # (K,) of the mean

    @staticmethod
    def of(gradients: list[np.ndarray]) -> Mean:
        return Mean(np.mean(gradients, 0), np.var(gradients, 0, ddof=1) / len(gradients))

    def beside(self, other: Mean) -> dict[str, float]:
        """The size of the difference as a share of the other's size, and how large it is by chance; the largest z."""
        off, by_chance = self.value - other.value, self.variance + other.variance
        size = float(np.linalg.norm(other.value))
        return {"off": float(np.linalg.norm(off)) / size, "by_chance": float(np.sqrt(by_chance.sum())) / size,
                "z": float(np.abs(off / np.sqrt(np.maximum(by_chance, 1e-300))).max())}


def measure(name: str, setting: Setting, effort: Effort) -> dict:
    """Times, variances and biases of each renderer in one scene, in this process.

    The reference is the mean of both, weighted by their variances, where they agree; else ours.
    """
    make, depth = SCENES[name]
    setting, start = setting._replace(max_depth=depth), time.monotonic()
    due = start + 60.0 * effort.minutes * OF_REFERENCES, start + 60.0 * effort.minutes
    with tempfile.TemporaryDirectory() as home:
        folder = Path(home)
        moving, fine = (make(folder, setting._replace(spp=spp)) for spp in (setting.spp, effort.finer * setting.spp))
        peer = Mitsuba(moving.scene, integrator=GUIDED)
        passes = {OURS: ours(fine, folder), DEFAULT: mitsubas(peer, fine, GUIDED)}
        fine_passes = {who: [] for who in passes}
        for seed in while_due(track(range(effort.references), "references", transient=True), FEWEST, due[0]):
            for who, run in passes.items():
                fine_passes[who].append(run(SEEDS + seed).gradient)
        means = {who: Mean.of(gradients) for who, gradients in fine_passes.items()}
        found = {"references": {"theirs beside ours": means[DEFAULT].beside(means[OURS])}}
        if effort.differences:
            run = differences(fine, folder, 2 * fine.scene.setting.spp)
            seeds = track(range(effort.differences), "differences", transient=True)
            slopes = Mean.of([run(2 * SEEDS + seed) for seed in seeds])
            found["references"] |= {f"{who} beside differences": mean.beside(slopes) for who, mean in means.items()}
        agree = found["references"]["theirs beside ours"]["z"] <= AGREES
        weights = {who: 1.0 / mean.variance.sum() if agree or who == OURS else 0.0 for who, mean in means.items()}
        reference = Mean(sum(weights[who] * mean.value for who, mean in means.items()) / sum(weights.values()),
                         sum(weights[who] ** 2 * mean.variance for who, mean in means.items()) / sum(weights.values()) ** 2)
        passes = {OURS: ours(moving, folder), DEFAULT: mitsubas(peer, moving, GUIDED),
                  **{who: mitsubas(peer, moving, integrator) for who, integrator in splits(setting.spp).items()}}
    samples = {who: [] for who in passes}
    seeds = track(range(-WARM_UP, effort.rounds), name, transient=True)
    for seed in while_due(seeds, WARM_UP + (FEWEST_SLOW - 1) * TIMES_LESS + 1, due[1]):
        for who, run in passes.items():
            if who in SLOW and (seed % TIMES_LESS if seed >= 0 else seed < -1):
                continue
            sampled = run(seed + WARM_UP)
            if seed >= 0:
                samples[who].append(sampled)
    return found | {"scene": name, "renderers": {
        who: judged([one.gradient for one in own], [one.seconds for one in own], means[OURS if who == OURS else DEFAULT],
                    reference) for who, own in samples.items()}}


def while_due(seeds: Iterable[int], fewest: int, due: float) -> Iterator[int]:
    """Seeds until it is late, by `time.monotonic`, but not fewer than some."""
    for number, seed in enumerate(seeds):
        if number >= fewest and time.monotonic() > due:
            return
        yield seed


def judged(gradients: list[np.ndarray], seconds: list[float], fine: Mean, reference: Mean) -> dict[str, float]:
    """What one renderer is worth, errors as shares of the reference's squared size; and the standard error of the variance.

    Args:
        gradients, seconds: of passes.
        fine: of the same estimator with more samples, from which its bias is seen.
        reference: what all are compared with.
    """
    size = float((reference.value ** 2).sum())
    variance = float(np.var(gradients, 0, ddof=1).sum()) / size
    off = fine.value - reference.value
    bias = max(0.0, float((off ** 2).sum() - fine.variance.sum() - reference.variance.sum())) / size
    without = [float(np.var([*gradients[:k], *gradients[k + 1:]], 0, ddof=1).sum()) / size for k in range(len(gradients))]
    count = len(gradients)
    spread = float(np.sqrt((count - 1) * np.var(without)))  # by the jackknife
    return {"passes": count, "seconds": statistics.median(seconds), "variance": variance, "spread": spread, "bias": bias}
