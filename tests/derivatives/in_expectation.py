"""Derivatives of a moving scene by every sampling that gives them, against the same finite differences."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

import torch_radbp as rb
from tests.scenes.moving import MovingScene
from torch_radbp.check.gradient import BatchRendering, Measurement, informative_cotangents
from torch_radbp.check.outcome import GradientCheck, Question, judge, uncertainty
from torch_radbp.check.statistics import Cotangent, Estimates, compare
from torch_radbp.check.stencil import BOTH_SIDES, ParameterMove

# A bias of the stated size is this many standard errors, so that 4 of them are exceeded whatever 2 of noise do.
CERTAIN = 6


class Row(NamedTuple):
    """How well the derivative of a scene is examined."""

    name: str
    bias: float  # relative, that must be noticed
    spp: int  # of a batch

    def __str__(self) -> str:
        return f"{self.name}, {self.bias:.0%}"


def assert_agrees(measured: Estimate, row: Row, verdicts: tuple[str, ...] = ("agrees",)) -> None:
    """Derivatives are those of differences, and if they were wrong by the row's bias, that would be noticed.

    Args:
        measured: of the row's scene.
        row: how well it is examined.
        verdicts: of `check_gradient` that are taken; whatever it is, standard errors must be so small.
    """
    for sampling, result in measured.checks().items():
        reference = result.comparison.difference
        assert reference.isfinite().all() and reference.abs().max() > 0, sampling
        assert result.verdict in verdicts, f"{sampling}: {result}"
        found = CERTAIN * uncertainty(result.comparison.projections[1])
        assert found < row.bias, f"{sampling}: {found:.3f} is not below {row.bias}: {result}"
        for projection in result.comparison.projections:
            assert abs(projection.z) <= 4, f"{sampling}: {result}"
            assert projection.backward_error < 1e-9, f"{sampling}: {result}"
    for error in (row.bias, -row.bias):
        for sampling, result in measured.checks(error).items():
            assert result.verdict.startswith("biased"), f"{sampling}, {error}: {result}"


class Effort(NamedTuple):
    """How much is rendered in a round, for each of the estimates."""

    spp: int  # samples per pixel of a batch
    batches: int  # independent ones, whose spread gives standard errors
    seed: int = 0
    compile: bool = True
    backward: bool = True  # compare the backward pass with forward mode, too
    terms: tuple[str, ...] | None = None  # of the derivative; None: all


class Estimate:
    """Batches of derivative images that become less noisy with every round; no two share samples.

    Sensors of the scene are batches that a call renders together: they are to see the same.
    """

    def __init__(self, moving: MovingScene, effort: Effort):
        self.moving, self.effort, self.rounds, self.used = moving, effort, 0, 0
        scene = moving.build()
        self.tangent = moving.tangent(scene)
        value = scene.get_parameter(moving.name).detach()
        self.eps = torch.finfo(value.dtype).eps
        self.measurements = {}
        for sampling in moving.samplings:
            renderer = rb.Renderer(scene, max_depth=moving.max_depth, sampling=sampling, compile=effort.compile,
                                   share_samples=True, **({} if effort.terms is None else {"terms": effort.terms}))
            move = ParameterMove(moving.step, BOTH_SIDES, self.tangent)
            self.measurements[sampling] = Measurement(renderer, f"scene.{moving.name}", value, move,
                                                      BatchRendering(effort.spp, effort.seed))
        self.sums: dict[str, Tensor] = {}
        self.rounding: Tensor | float = 0.0
        reference = self.plain.difference(self.new_number()).value
        self.sensors = len(reference)
        self.calls = -(-effort.batches // self.sensors)
        self.cotangents: list[Cotangent] = informative_cotangents(reference.mean(0, keepdim=True), effort.seed)
        self.backward = {sampling: [0.0] * len(self.cotangents) for sampling in moving.samplings}

    @property
    def plain(self) -> Measurement:
        """By which differences are rendered: any, for they carry no derivatives."""
        return next(iter(self.measurements.values()))

    def new_number(self) -> int:
        """Of a batch that has not been rendered."""
        self.used += 1
        return self.used - 1

    def add(self, name: str, images: list[Tensor]) -> None:
        """Adds the images of some calls, (sensors, 3, H, W) each, to the (batches, 1, 3, H, W) sums of an estimate."""
        self.sums[name] = torch.cat(images)[:, None] + self.sums.get(name, 0)

    def for_the_first(self, cotangent: Tensor) -> Tensor:
        """A cotangent (1, 3, H, W) of the first sensor of a call."""
        return torch.cat([cotangent, cotangent.new_zeros(self.sensors - 1, *cotangent.shape[1:])])

    def add_round(self) -> None:
        """Renders every batch of every estimate once more."""
        self.rounds += 1
        found = [self.plain.difference(self.new_number()) for _ in range(self.calls)]
        self.add("differences", [difference.value for difference in found])
        sizes = torch.cat([difference.size for difference in found])
        self.rounding = self.eps * sizes.amax(0, keepdim=True) / self.moving.step
        for sampling, measurement in self.measurements.items():
            numbers = [self.new_number() for _ in range(self.calls)]
            self.add(sampling, [measurement.forward(number)[1] for number in numbers])
            if not self.effort.backward:
                self.backward[sampling] = [float((w.image * self.sums[sampling][0]).sum()) for w in self.cotangents]
                continue
            backward = measurement.backward(numbers[0], [self.for_the_first(w.image) for w in self.cotangents])
            self.backward[sampling] = [old + new for old, new in zip(self.backward[sampling], backward)]

    def checks(self, error: float = 0.0) -> dict[str, GradientCheck]:
        """What `rb.check_gradient` would say, for each sampling, of derivatives that are wrong by the factor 1 + `error`."""
        found, effort, factor = {}, self.effort, (1 + error) / self.rounds
        for sampling in self.measurements:
            samples = Estimates(self.sums["differences"] / self.rounds, factor * self.sums[sampling], self.rounding)
            backward = [factor * value for value in self.backward[sampling]]
            comparison = compare(samples, self.cotangents, backward, self.eps)
            batches = len(samples.jvp)
            question = Question(self.moving.name, self.tangent, self.moving.step, BOTH_SIDES.words,
                                effort.spp * batches * self.rounds, batches, effort.seed, True, [])
            found[sampling] = judge(question, comparison)
        return found
