"""Seconds of Gauss-Newton and of Adam to the same error."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from itertools import product
from typing import Any, NamedTuple

import torch
from torch import Tensor

import torch_radbp as rb
from benchmarks.uncertainty.tasks import Task

FLOOR = 0.1  # of radiance, added to what residuals are relative to
RATES = (0.003, 0.01, 0.03, 0.1, 0.3)  # of Adam, times the size of each parameter
STEPS = 12  # of Gauss-Newton


class Race(NamedTuple):
    """Seconds to an error, and the error; Adam's, by its best learning rate, may be infinite."""

    error: float
    gauss_newton: float
    adam: float
    rate: float
    patience: float

    def __str__(self) -> str:
        adam = f"{self.adam:7.2f} s, rate {self.rate}" if self.adam < math.inf else f"> {self.patience:5.2f} s"
        share = self.gauss_newton / min(self.adam, self.patience)
        return (f"error {100 * self.error:6.2f} %: Gauss-Newton {self.gauss_newton:6.2f} s, Adam {adam}; over Adam "
                f"{share:.3f}" + ("" if self.adam < math.inf else " at most"))


def raced(task: Task, patience: float) -> Race:
    """Seconds of Gauss-Newton and Adam from one start to the same error."""
    truth, wanted, generator = task.position(), task.compared(), torch.Generator().manual_seed(3)
    with torch.no_grad():
        target = task.images(10 ** 6, 16384)
    scale, start, unit = target + FLOOR, task.start(truth, generator), task.unit(wanted)

    def error() -> float:
        off = (task.compared() - wanted) / unit.clamp_min(1e-12)
        return float(off[unit > 0].square().mean().sqrt())

    def residuals(seed: int, spp: int | None) -> Tensor:
        return (task.images(seed, spp) - target) / scale

    def newton() -> list[tuple[float, float]]:
        task.move(start)
        optimizer = rb.optim.GaussNewton(task.parameters.values(), task.scene, spp=64, max_spp=1024)
        return timed(lambda number: optimizer.step(residuals), error, STEPS, math.inf)

    newton()
    course = newton()
    level = 1.2 * course[-1][1]
    seconds = next(at for at, off in course if off <= level)
    limit, best, rate = patience * seconds, math.inf, math.nan
    for parameter in task.parameters.values():
        parameter.requires_grad_()
    for spp in (16, 64):
        residuals(10 ** 5, spp).square().mean().backward()  # compiles
    for each, spp in product(RATES, (16, 64)):
        task.move(start)
        adam = rb.optim.bounded(torch.optim.Adam([
            {"params": [parameter], "lr": each * float(parameter.detach().abs().mean().clamp_min(0.1))}
            for parameter in task.parameters.values()]), task.scene)

        def step(number: int, adam: torch.optim.Adam = adam, spp: int = spp) -> None:
            adam.zero_grad()
            a, b = (residuals(2 * number + k, spp) for k in (0, 1))
            (a * b).mean().backward()
            adam.step()

        at = next((at for at, off in timed(step, error, 10 ** 6, min(limit, best), level) if off <= level), math.inf)
        if at < best:
            best, rate = at, each
    task.move(truth)
    return Race(level, seconds, best, rate, limit)


def timed(step: Callable[[int], Any], error: Callable[[], float], steps: int, limit: float, level: float = 0.0
          ) -> list[tuple[float, float]]:
    """Seconds of the processor after each step, and the error there, until one is reached; the error is not timed."""
    spent, course = 0.0, []
    for number in range(steps):
        began = time.process_time()
        step(number)
        spent += time.process_time() - began
        course.append((spent, error()))
        if spent > limit or course[-1][1] <= level:
            break
    return course
