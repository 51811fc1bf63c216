"""Derivatives by the backward pass beside finite differences of samples of their own: several parameters in one rendering.

Compiled code depends on which parameters are differentiated, so that one rendering for all of them is compiled once.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

import torch_radbp as rb
from tests.gradients import unwarned_renderer
from torch_radbp.check.gradient import NEXT_SEED, checked_direction
from torch_radbp.check.stencil import ParameterMove, inside

BATCHES = 8  # the fewest by which standard errors are known well enough


class Move(NamedTuple):
    """How a parameter moves for differences; no direction: that of `check_gradient`."""

    name: str
    step: float
    direction: Tensor | None = None


class Compared(NamedTuple):
    """Derivatives of one number, (R,) of R independent batches: by the backward pass, and of differences."""

    name: str
    gradient: Tensor
    difference: Tensor

    @property
    def standard_error(self) -> float:
        """That of the mean of the one minus the other."""
        return math.sqrt(float(self.gradient.var() + self.difference.var()) / len(self.gradient))

    @property
    def error(self) -> float:
        return float(self.gradient.mean() - self.difference.mean())

    def assert_agrees(self, most: float, farthest: float = 4.0) -> None:
        """They differ by few standard errors, of which each is less than a share `most` of the derivative."""
        wanted, noise = float(self.difference.mean()), self.standard_error
        assert math.isfinite(wanted) and 0 < noise < most * abs(wanted), (self.name, wanted, noise)
        assert abs(self.error) < farthest * noise, (self.name, wanted, self.error / noise)


def compared(scene: rb.Scene, moves: Sequence[Move], spp: int, *, gradient_spp: int | None = None, seed: int = 3,
             batches: int = BATCHES, along: bool = False, **settings) -> list[Compared]:
    """Compares derivatives of the mean of an image by some moves of parameters.

    Args:
        scene: nothing but these parameters will require a gradient.
        moves: of one parameter or of several.
        spp: samples per pixel of all batches, of each image of the differences.
        gradient_spp: of the gradients; None: as many.
        seed: of the random numbers; no two batches share any, but the images of one difference do.
        batches: independent repetitions.
        along: of the image's product with its own derivative, by differences of a batch more, in the place of the mean:
            where a derivative has both signs.
        **settings: of the renderer.
    """
    scene.requires_grad_(False)
    leaves = {move.name: scene.get_parameter(move.name).requires_grad_() for move in moves}
    places = [inside(scene, move.name, checked_direction(move.name, leaves[move.name].detach(), move.direction), move.step,
                     chosen=True, turns=move.direction is None) for move in moves]
    settings = {"spp": -(-spp // batches), "share_samples": True, **settings}
    renderer = unwarned_renderer(scene, **settings)
    without_terms = unwarned_renderer(scene, **settings | {"terms": ("interior",)})  # the same images, sooner
    seeds = [seed + NEXT_SEED * number for number in range(2 * batches + 1)]
    images = [_differences(without_terms, leaves[move.name], place, seeds[:batches + 1])
              for move, place in zip(moves, places)]
    weights = [each[batches] / each[batches].norm() if along else torch.full_like(each[0], 1 / each[0].numel())
               for each in images]
    gradients: list[list[Tensor]] = [[] for _ in moves]
    for number in seeds[batches + 1:]:
        image = renderer(seed=number, spp=-(-(gradient_spp or spp) // batches))
        for move, place, weight, found in zip(moves, places, weights, gradients):
            gradient, = torch.autograd.grad(image, leaves[move.name], weight.to(image), retain_graph=True)
            found.append((gradient * place.direction).sum())
    return [Compared(move.name, torch.stack(found), (each[:batches] * weight).flatten(1).sum(1))
            for move, found, each, weight in zip(moves, gradients, images, weights)]


@torch.no_grad()
def _differences(renderer: rb.Renderer, leaf: Tensor, place: ParameterMove, seeds: list[int]) -> Tensor:
    """(R, B, 3, H, W) difference quotients of images, sampled as those whose parameters are differentiated."""
    step, stencil, direction = place
    at, total = leaf.clone(), torch.tensor(0.0)
    for offset, weight in zip(stencil.offsets, stencil.weights):
        if weight:
            leaf.copy_(at + offset * step * direction)
            total = total + weight / step * torch.stack([renderer(seed=each) for each in seeds])
    leaf.copy_(at)
    return total
