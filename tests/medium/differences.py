"""Gradients of a functional of an image, and differences of it with samples of their own, for every entry of a parameter,
or along one direction through all."""

from __future__ import annotations

import math
from statistics import NormalDist
from typing import NamedTuple

import torch
from torch import Tensor

import torch_radbp as rb
from tests.gradients import unwarned_renderer
from tests.scenes.media_rows import MEDIA, PARAMETERS, Row, scene_of
from torch_radbp.check.gradient import BatchRendering, Measurement
from torch_radbp.check.stencil import inside

OWN_SAMPLES = 1 << 16  # numbers of the batches of gradients, behind those of differences
CLOSE, FARTHEST = 0.03, 3.5  # of the vector; standard errors of one number
NO_ROULETTE, FEWEST = 1000, 24  # batches, with which standard errors can be trusted
LONGEST = 0.03  # step in fog that fills all space, where ways are long
THICKEST = 0.15  # step where hardly any light is left: differences by 0.4 are off by 5%
SMOKE = 1.0  # that extinctions of cells count as at least: a ray meets some of a cell, so that they change little
WEIGHTS = (0.5, 1.5)  # of pixels: uneven, so that errors do not cancel, and of one sign, so that the derivative does not


class Comparison(NamedTuple):
    """A gradient and differences, (E,) each, for E entries or directions, with standard errors."""

    gradient: Tensor
    difference: Tensor
    gradient_error: Tensor
    difference_error: Tensor

    @property
    def standard_error(self) -> Tensor:
        return torch.hypot(self.gradient_error, self.difference_error)

    @property
    def size(self) -> float:
        return max(float(self.difference.norm()), 1e-30)

    @property
    def error(self) -> float:
        """How far the vectors are apart, relative to the differences."""
        return float((self.gradient - self.difference).norm()) / self.size

    @property
    def noise(self) -> float:
        """What of `error` standard errors explain."""
        return float(self.standard_error.norm()) / self.size

    @property
    def z(self) -> float:
        """The distance of the worst entry, in standard errors; entries that are 0 for sure count nothing."""
        apart = (self.gradient - self.difference).abs()
        return float((apart / self.standard_error.clamp_min(1e-6 * self.size)).max())

    @property
    def bound(self) -> float:
        """The z that the worst of E entries exceeds as rarely as one number exceeds 3.5 (Bonferroni)."""
        return -NormalDist().inv_cdf((1 - NormalDist().cdf(FARTHEST)) / len(self.gradient))

    @property
    def verdict(self) -> str:
        if not (1e-20 < self.size < math.inf and bool(torch.isfinite(self.gradient).all())):
            return "**not finite, or zero**"
        if self.error > CLOSE and self.z > self.bound:
            return "**wrong**"
        if self.noise > CLOSE:
            return "not known"
        return "right" if self.error <= CLOSE else f"within {FARTHEST} standard errors"


class Batches:
    """Values (E,) of batches, their mean and its standard error."""

    def __init__(self) -> None:
        self.values: list[Tensor] = []

    def mean(self) -> Tensor:
        return torch.stack(self.values).mean(0)

    def error(self) -> Tensor:
        return torch.stack(self.values).std(0) / math.sqrt(len(self.values))


class Experiment:
    """The derivative of a functional of the image of a row by its parameter.

    Args:
        row: the scene, and the parameter.
        spp: samples a pixel of a batch.
        seed: of the random numbers.
        compile: as for `Renderer`.
        along: one direction alone, along which all entries grow, each by another share.
    """

    def __init__(self, row: Row, spp: int, seed: int = 0, compile: bool = True, along: bool = False):
        self.row, self.spp, self.seed = row, spp, seed
        self.scene = rb.load_dict(tensors(scene_of(row)))
        self.parameter, names = PARAMETERS[row.parameter], dict(self.scene.named_parameters())
        self.name, = (name for name in self.parameter.names if name in names)
        self.leaf = names[self.name].requires_grad_()
        self.renderer = unwarned_renderer(self.scene, spp=spp, max_depth=row.depth, share_samples=True, compile=compile,
                                          terms=("interior",), rr_depth=5 if row.depth > 8 else NO_ROULETTE)
        film = self.renderer(seed=seed, spp=1)
        self.cotangent = torch.rand(film.shape, generator=torch.Generator().manual_seed(seed)) + WEIGHTS[0]
        self.cotangent /= film.numel()
        self.directions = [torch.linspace(0.5, 1.5, self.leaf.numel()).view_as(self.leaf)] if along else directions(
            self.leaf.detach(), self.parameter.poses)
        value, batch = self.leaf.detach().clone(), BatchRendering(spp, seed)
        grid = MEDIA[row.medium]["type"] == "heterogeneous"
        most = math.inf if grid else LONGEST if row.boundary == "none" else THICKEST if row.medium == "dense" else math.inf
        share, least = self.parameter.step, SMOKE if grid and row.parameter == "extinction" else self.parameter.least

        def step(direction: Tensor) -> float:
            """As large as noise asks for; from 0, where differences are less exact, and have less noise, a small one."""
            own, largest = (float(each.abs().max()) for each in (value * direction, value))
            size = 1.0 if self.parameter.poses else largest if own > 0 and value.numel() > 3 else own
            return min(share * max(size, least), most)

        self.measurements = [Measurement(self.renderer, f"scene.{self.name}", value, inside(
            self.scene, self.name, each, step(each), chosen=True, turns=False), batch) for each in self.directions]
        self.gradients, self.differences = Batches(), Batches()

    def add_batch(self) -> None:
        """Renders a batch more of both."""
        number = len(self.gradients.values)
        image = self.renderer(seed=self.measurements[0].arguments(OWN_SAMPLES + number)["seed"])
        gradient, = torch.autograd.grad(image, self.leaf, self.cotangent)
        self.gradients.values.append(torch.stack([(gradient * each).sum() for each in self.directions]).double())
        self.differences.values.append(torch.stack([(each.difference(number).value * self.cotangent).sum()
                                                    for each in self.measurements]))

    def comparison(self) -> Comparison:
        return Comparison(self.gradients.mean(), self.differences.mean(), self.gradients.error(), self.differences.error())


def directions(value: Tensor, poses: bool) -> list[Tensor]:
    """Directions along which a parameter is compared: its entries; of a pose how it is moved, grows and is turned."""
    if not poses:
        return [each.view_as(value) for each in torch.eye(value.numel())]
    found = []
    for axis in range(3):
        generator = torch.zeros(4, 4)
        generator[axis, 3] = 1.0
        found.append(generator @ value)
    grows, turns = torch.diag(torch.tensor([1.0, 1.0, 1.0, 0.0])), torch.zeros(4, 4)
    turns[0, 1], turns[1, 0] = 1.0, -1.0
    return [*found, grows @ value, turns @ value]


def tensors(described: dict) -> dict:
    """A scene's description with tensors in place of the values of grids."""
    return {key: tensors(value) if isinstance(value, dict) else torch.from_numpy(value).float()
            if key == "data" and value.ndim == 4 else value for key, value in described.items()}
