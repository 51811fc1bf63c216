"""How samples are split between the integrals that borders of shadows cut off.

Samples are worth taking where they lower the noise of the whole. Of the first integral all are taken. Of each of the others
a few tell how much noise there is. They are not used otherwise: were their numbers to decide how many others they are added
to, large ones would count less. Sums of integrals that have variances V with as many samples each are the least noisy for
their cost with samples in proportion to sqrt(V / c), c the time of a sample. Looking at all costs as much as many samples:
those that are taken in any case are found together with those that tell the noise, and others only if they are worth it.

Reference: Owen 2013, "Monte Carlo theory, methods and examples", section 8.4 (Neyman allocation).
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import torch
from torch import Tensor

from torch_radbp.call.render_call import RenderCall
from torch_radbp.sampling.sampler import SampleKey, hash32

TRIED = 1 / 16  # share of the samples that tell the noise
LEAST = 1 / 4  # share of the samples that are taken in any case
COST = 3.0  # times as long as a sample of the first integral one of the others takes
WORTH = 1 << 16  # paths of an image from which on it is worth trying
SALT = 0x5851F42D  # tells the random numbers of what is tried from others


class SampledIntegral(Protocol):
    """Samples of one of the integrals."""

    def independent(self) -> Tensor:
        """(3, N) what changes in the image where all edges move outwards by a step that is the same for all integrals, in
        parts of which none depends on another: the variance of their sum is the sum of their squares."""


class Amount(NamedTuple):
    """How many of its samples an integral takes, as shares of the most."""

    counted: float = 1.0
    tried: float = 0.0  # beside these, by random numbers of their own: they only tell the noise
    before: float = 0.0  # how many counted ones there are already


ALL = Amount()


def trying(call: RenderCall) -> RenderCall:
    """The call with random numbers of its own for what is tried."""
    return with_numbers(call, SALT)


def with_numbers(call: RenderCall, salt: int) -> RenderCall:
    """The call with other random numbers."""
    return call.with_views([view._replace(sample_keys=tuple(
        SampleKey(hash32(key.seed ^ salt), key.shared) for key in view.sample_keys)) for view in call.views])


def is_worth_trying(call: RenderCall, number: int) -> bool:
    """True if view `number` has so many samples that it pays to split them.

    Borders of light without extent are single curves, on which places are spread so evenly that their sum has far less noise
    than independent ones: where there are any, all samples are taken.
    """
    view, lights = call.views[number], call.scene.layout.lights
    return view.width * view.height * call.spp >= WORTH and not any(kind.delta for kind in lights)


def variance(found: SampledIntegral | None) -> float:
    """That of the sum of samples, where all edges move by the same; None: there are none."""
    return 0.0 if found is None else squares(found.independent())


def squares(amounts: Tensor) -> float:
    """The sum of the squares of those that are finite, (3, N)."""
    return float(torch.where(torch.isfinite(amounts), amounts, 0.0).square().sum())


def effort(first: float, tried: SampledIntegral | None) -> float:
    """The share of its samples that an integral is worth.

    Args:
        first: variance of the first integral, with all of its samples.
        tried: the other, with a share of `TRIED`; None: nothing of it counts.
    """
    return min(1.0, max(LEAST, (TRIED * variance(tried) / (COST * first))**0.5)) if first > 0.0 else 1.0
