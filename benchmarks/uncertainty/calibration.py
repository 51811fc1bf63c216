"""Standard deviations of what refits find over the predicted ones."""

from __future__ import annotations

import time
from typing import NamedTuple

import torch
from torch import Tensor

import torch_radbp as rb
from benchmarks.uncertainty.tasks import Task

FLOOR = 0.1  # of radiance, added to what noise is relative to
LEVEL = 0.05  # noise of a pixel of the targets, relative
STEPS, SPP, MAX_SPP = 5, 256, 1024  # of a refit
MANY, STEPS_OF_MANY, ITERATIONS = 64, 3, 40  # for more parameters, by conjugate gradients
DENSE = 200  # parameters up to which the whole covariance is computed


class Calibration(NamedTuple):
    """Deviations of refits over predicted ones, of each parameter, and the share of intervals that hold the truth."""

    ratios: Tensor
    coverage: float
    untold: int  # numbers that are said not to be known
    by_images: float  # the share of numbers whose predicted deviation is below half of the prior's, 1 without a prior
    seconds: float

    def __str__(self) -> str:
        typical = float(self.ratios.square().mean().sqrt())
        return (f"deviations of refits over predicted {typical:.2f} (median {float(self.ratios.median()):.2f}, "
                f"{float(self.ratios.min()):.2f} to {float(self.ratios.max()):.2f}), coverage {100 * self.coverage:.1f} %"
                + (f", {self.untold} not told" if self.untold else "")
                + (f", {100 * self.by_images:.0f} % known to less than half of the prior" if self.by_images < 1 else "")
                + f", {self.seconds:.0f} s")


def predicted(task: Task, exact: Tensor, noise: Tensor) -> Tensor:
    """The predicted standard deviations of what is compared, (k,) float64."""
    spp = 64 if task.size > MANY else 256
    prior = None if task.prior is None else dict.fromkeys(task.parameters, task.prior)
    if task.size > DENSE:
        found = rb.diagonal_covariance(task.images, task.parameters, noise=noise, prior=prior, spp=spp, probes=64,
                                       seed=10 ** 5)
        return torch.cat([deviation.reshape(-1) for deviation in found.standard_deviations.values()])
    whole = rb.covariance(task.images, exact, task.parameters, noise=noise, prior=prior, spp=spp, repeats=4, seed=10 ** 5)
    return whole.matrix.diag().sqrt() if task.outputs is None else whole.propagated(task.outputs).reshape(-1)


def calibrated(task: Task, refits: int) -> Calibration:
    """Fits a task to many noisy targets, each time beginning at the truth, since only the spread is asked for.

    With a prior what is believed beforehand is as far from the truth as it says, and takes part in the fit.
    """
    began, truth, wanted = time.process_time(), task.position(), task.compared()
    generator = torch.Generator().manual_seed(0)
    with torch.no_grad():
        exact = task.images(10 ** 6, 16384)
    noise = LEVEL * (exact + FLOOR)
    deviation, found = predicted(task, exact, noise), []
    for refit in range(refits):
        target = exact + noise * torch.randn(exact.shape, generator=generator)
        believed = truth + (task.prior or 0.0) * torch.randn(len(truth), generator=generator, dtype=truth.dtype)

        def residuals(seed: int, spp: int | None, target: Tensor = target, believed: Tensor = believed) -> list[Tensor]:
            off = (task.images(seed, spp) - target) / noise
            if task.prior is None:
                return [off]
            now = torch.cat([parameter.reshape(-1) for parameter in task.parameters.values()])
            return [off, (now - believed.to(now)) / task.prior]

        task.move(truth)
        optimizer = rb.optim.GaussNewton(task.parameters.values(), spp=SPP, max_spp=MAX_SPP, iterations=ITERATIONS,
                                         seed=1000 * refit)
        for _ in range(STEPS_OF_MANY if task.size > MANY else STEPS):
            optimizer.step(residuals)
        found.append(task.compared())
    task.move(truth)
    told = deviation.isfinite()
    all_found = torch.stack(found)[:, told]
    inside = ((all_found - wanted[told]).abs() <= 1.96 * deviation[told]).double().mean()
    share = 1.0 if task.prior is None or task.outputs else float((deviation < task.prior / 2).double().mean())
    return Calibration(all_found.std(0) / deviation[told], float(inside), int((~told).sum()), share,
                       time.process_time() - began)
