"""Derivatives of a moving scene by every sampling that gives them, against the same finite differences."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

import torch_radbp as rb
from tests.derivatives.moving_scenes import MovingScene
from torch_radbp.check.gradient import Measurement, informative_cotangents
from torch_radbp.check.outcome import GradientCheck, judge
from torch_radbp.check.statistics import Cotangent, Samples, compare


class Effort(NamedTuple):
    """How much is rendered in a round, for each of the estimates."""

    spp: int  # samples per pixel of a batch
    batches: int  # independent ones, whose spread gives standard errors
    seed: int = 0


class Estimate:
    """Batches of derivative images that become less noisy with every round; no two share samples."""

    def __init__(self, moving: MovingScene, effort: Effort):
        self.moving, self.effort, self.rounds, self.used = moving, effort, 0, 0
        scene = moving.build()
        self.tangent = moving.tangent(scene)
        value = scene.get_parameter(moving.name).detach()
        self.eps = torch.finfo(value.dtype).eps
        self.measurements = {}
        for sampling in moving.samplings:
            renderer = rb.Renderer(scene, max_depth=moving.max_depth, sampling=sampling)
            self.measurements[sampling] = Measurement(renderer, f"scene.{moving.name}", value, self.tangent, moving.step,
                                                      effort.spp, effort.seed, None, None, total=0)
        self.sums: dict[str, Tensor] = {}
        self.rounding: Tensor | float = 0.0
        reference, _ = self.plain.difference(self.new_number())
        self.cotangents: list[Cotangent] = informative_cotangents(reference, effort.seed)
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
        self.sums[name] = torch.stack(images) + self.sums.get(name, 0)

    def add_round(self) -> None:
        """Renders every batch of every estimate once more."""
        self.rounds += 1
        pairs = [self.plain.difference(self.new_number()) for _ in range(self.effort.batches)]
        self.add("differences", [difference for difference, _ in pairs])
        self.rounding = self.eps * torch.stack([size for _, size in pairs]).amax(0) / self.moving.step
        for sampling, measurement in self.measurements.items():
            numbers = [self.new_number() for _ in range(self.effort.batches)]
            self.add(sampling, [measurement.forward(number)[1] for number in numbers])
            backward = measurement.backward(numbers[0], [cotangent.image for cotangent in self.cotangents])
            self.backward[sampling] = [old + new for old, new in zip(self.backward[sampling], backward)]

    def checks(self, error: float = 0.0) -> dict[str, GradientCheck]:
        """What `rb.check_gradient` would say, for each sampling, of derivatives that are wrong by the factor 1 + `error`."""
        found, effort, factor = {}, self.effort, (1 + error) / self.rounds
        for sampling in self.measurements:
            samples = Samples(self.sums["differences"] / self.rounds, factor * self.sums[sampling], self.rounding)
            backward = [factor * value for value in self.backward[sampling]]
            comparison = compare(samples, self.cotangents, backward, self.eps)
            found[sampling] = judge(self.moving.name, self.tangent, self.moving.step,
                                    effort.spp * effort.batches * self.rounds, effort.batches, effort.seed, True, comparison)
        return found
