"""How samples are split between the integrals that borders of shadows cut off.

Samples are worth taking where they lower the noise of the whole. Of the first integral all are taken. Of each of the others
a few tell how much noise there is. They are not used otherwise: were their numbers to decide how many others they are added
to, large ones would count less. Sums of integrals that have variances V with as many samples each are the least noisy for
their cost with samples in proportion to sqrt(V).

Reference: Owen 2013, "Monte Carlo theory, methods and examples", section 8.4 (Neyman allocation).
"""

from __future__ import annotations

from typing import Protocol

import torch
from torch import Tensor

from torch_radbp.call.render_call import RenderCall
from torch_radbp.sampling.sampler import SampleKey, hash32

TRIED = 1 / 16  # share of the samples that tell the noise
LEAST = 1 / 8  # share of the samples that are taken where there is little of it,
UNKNOWN, ENOUGH = 1 / 2, 32  # and where fewer than so many counted, of which the noise cannot be told
WORTH = 1 << 16  # paths of an image from which on it is worth trying
SALT = 0x5851F42D  # tells the random numbers of what is tried from others


class Sampled(Protocol):
    """K samples of one of the integrals."""

    strength: Tensor  # (3, K) by which the image changes for each unit of `sweep`
    sweep: Tensor  # (K,) of the border, where its edge moves outwards by a step that is the same for all integrals


def trying(call: RenderCall) -> RenderCall:
    """The call with random numbers of its own for what is tried."""
    return call._replace(views=[view._replace(sample_keys=tuple(
        SampleKey(hash32(key.seed ^ SALT), key.shared) for key in view.sample_keys)) for view in call.views])


def is_worth_trying(call: RenderCall, number: int) -> bool:
    """True if view `number` has so many samples that it pays to split them."""
    view = call.views[number]
    return view.width * view.height * call.spp >= WORTH


def variance(found: Sampled | None) -> float:
    """That of the sum of samples, where all edges move by the same."""
    if found is None:
        return 0.0
    amount = (found.strength * found.sweep).square().sum(0)
    return float(torch.where(torch.isfinite(amount), amount, 0.0).sum())


def effort(first: float, tried: Sampled | None) -> float:
    """The share of its samples that an integral is worth.

    Args:
        first: variance of the first integral, with all of its samples.
        tried: the other, with a share of `TRIED`; None: nothing of it counts.
    """
    if not first > 0.0:
        return 1.0
    known = tried is not None and len(tried.sweep) >= ENOUGH
    return min(1.0, max(LEAST if known else UNKNOWN, (TRIED * variance(tried) / first)**0.5))
