"""How noisy derivatives are by hybrid and by attached sampling, where rough surfaces reflect or bend light."""

from __future__ import annotations

from typing import NamedTuple

import torch

import torch_radbp as rb
from tests.scenes.rough import NoisyDerivative


class Noise(NamedTuple):
    """The spread of a derivative image from seed to seed."""

    deviation: float  # root mean square over the pixels, of one image
    size: float  # root mean square of their mean, without what noise adds to it


def noise(derivative: NoisyDerivative, sampling: str, seeds: int, spp: int, max_depth: int = 8) -> Noise:
    """How noisy a derivative is, without shadows, which not all samplings have. Two seeds tell, if there are many pixels."""
    scene = derivative.build()
    tangent = derivative.tangent(scene.get_parameter(derivative.name).detach())
    images = torch.stack([rb.jvp(scene, {derivative.name: tangent}, spp=spp, seed=seed, max_depth=max_depth, rr_depth=99,
                                 sampling=sampling, terms=("interior", "primary")) for seed in range(seeds)]).double()
    variance = images.var(0)
    size = (images.mean(0).square() - variance / seeds).mean().clamp_min(0.0)
    return Noise(float(variance.mean().sqrt()), float(size.sqrt()))
