"""Runs of a task with several renderers, step by step in turns, and what came out."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Iterable
from typing import NamedTuple, Protocol

import numpy as np

OURS = "ours"  # what the names of runs of this renderer begin with
SLACK = 1.5  # of the error at the end, which the curves have to reach
LAST = 0.1  # of the steps, whose errors are averaged as that at the end
CONVERGED = 0.5  # of the error at the start, that a run has to leave behind


class Loop(Protocol):
    """A run of one of the renderers."""

    def step(self, number: int) -> float:
        """One step; the seconds that it took."""

    def found(self) -> dict[str, np.ndarray]: ...


class Curve(NamedTuple):
    """A run: seconds since its start, and the error then; the first entry is the first guess."""

    seconds: list[float]
    errors: list[float]
    complete: bool
    """False where the seconds that there were did not suffice for all steps."""

    @property
    def final(self) -> float:
        """The mean error of the last steps."""
        return statistics.fmean(self.errors[-max(1, round(LAST * len(self.errors))):])

    @property
    def converged(self) -> bool:
        return self.final <= CONVERGED * self.errors[0]

    def reaches(self, error: float) -> float | None:
        """The seconds after which the error stays at `error` or below; None if it does not."""
        above = [number for number, value in enumerate(self.errors) if value > error]
        after = above[-1] + 1 if above else 0
        return self.seconds[after] if after < len(self.seconds) else None


def race(loops: dict[str, Loop], error: Callable[[dict[str, np.ndarray]], float], steps: int, most_seconds: float,
         watched: Callable[[], None]) -> dict[str, Curve]:
    """Steps by turns, until all are done or have used up their seconds.

    Args:
        loops: by the name of the renderer.
        error: of what was found; looking at it takes no part in the seconds.
        steps: of each.
        most_seconds: of each; who has used them up steps no more.
        watched: called after every turn.
    """
    seconds = {name: [0.0] for name in loops}
    errors = {name: [error(loop.found())] for name, loop in loops.items()}
    for number in range(steps):
        for name, loop in loops.items():
            if seconds[name][-1] < most_seconds:
                seconds[name].append(seconds[name][-1] + loop.step(number))
                errors[name].append(error(loop.found()))
        watched()
    return {name: Curve(seconds[name], errors[name], len(errors[name]) == steps + 1) for name in loops}


class Outcome(NamedTuple):
    """Of all runs of one renderer, medians."""

    final: float
    seconds: float | None
    """To the common error; None if fewer than half of the runs reach it."""
    step: float
    """Seconds of one step."""
    complete: bool
    converged: bool


def is_ours(name: str) -> bool:
    """True of the name of runs of this renderer."""
    return name.startswith(OURS)


def common_error(runs: dict[str, list[Curve]]) -> float:
    """1.5 times the error at the end of our best or of Mitsuba's, whichever is greater; stopped runs end where they are."""
    finals = {name: statistics.median(curve.final for curve in curves) for name, curves in runs.items()}
    return SLACK * max(min(final for name, final in finals.items() if is_ours(name) == own) for own in (True, False))


def soonest(runs: dict[str, list[Curve]], error: float, most: int) -> dict[str, list[Curve]]:
    """So many runs that reach an error first, ours before others, among them the first of both."""
    seconds = {name: outcome(curves, error).seconds or float("inf") for name, curves in runs.items()}
    ours, theirs = (sorted((name for name in runs if is_ours(name) == own), key=seconds.get) for own in (True, False))
    return {name: runs[name] for name in (ours[:most // 2] + theirs)[:most]}


def outcome(curves: list[Curve], error: float) -> Outcome:
    """What the runs of a renderer came to."""
    reached = [curve.reaches(error) for curve in curves]
    found = sorted(seconds for seconds in reached if seconds is not None)
    steps = [after - before for curve in curves for before, after in zip(curve.seconds, curve.seconds[1:])]
    enough = 2 * len(found) > len(curves)
    # The runs that do not reach it count as endless.
    middle = statistics.median_low([*found, *[float("inf")] * (len(curves) - len(found))])
    return Outcome(statistics.median(curve.final for curve in curves), middle if enough else None, statistics.median(steps),
                   all(curve.complete for curve in curves), all(curve.converged for curve in curves))


def fastest(outcomes: Iterable[Outcome]) -> float | None:
    """The seconds of the one that is first."""
    return min((each.seconds for each in outcomes if each.seconds is not None), default=None)
