"""A derivative by forward mode beside finite differences of samples of their own, batch by batch."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

import torch_radbp as rb
from tests.gradients import unwarned_renderer
from torch_radbp.check.gradient import FEWEST_BATCHES, BatchRendering, Measurement, checked_direction
from torch_radbp.check.stencil import inside


class Compared(NamedTuple):
    """Derivatives of an image, (R, B, 3, H, W) of R independent batches."""

    jvps: Tensor
    differences: Tensor

    @property
    def jvp(self) -> Tensor:
        return self.jvps.mean(0)

    @property
    def difference(self) -> Tensor:
        return self.differences.mean(0)

    @property
    def standard_error(self) -> Tensor:
        """That of the one minus the other, pixel by pixel."""
        return (self.jvps - self.differences).std(0) / math.sqrt(len(self.jvps))


def compared(scene: rb.Scene, name: str, step: float, spp: int, seed: int, **settings) -> Compared:
    """Compares them as `check_gradient` does, which renders three times as often, for what nobody asks here.

    Args:
        scene, name: the parameter.
        step: of the differences, to both sides, or from the end of its range.
        spp: samples per pixel of all batches.
        seed: of the random numbers.
        **settings: of the renderer.
    """
    parameter, batches = scene.get_parameter(name).detach(), FEWEST_BATCHES
    place = inside(scene, name, checked_direction(name, parameter, None), step, chosen=True, turns=True)
    renderer = unwarned_renderer(scene, share_samples=True, **settings)
    measurement = Measurement(renderer, f"scene.{name}", parameter, place, BatchRendering(spp // batches, seed))
    return Compared(torch.stack([measurement.forward(number)[1] for number in range(batches)]),
                    torch.stack([measurement.difference(batches + number).value for number in range(batches)]))
