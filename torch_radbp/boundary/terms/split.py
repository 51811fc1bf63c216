"""Divides samples among the boundary integrals of shadows by the noise that they remove.

Samples are worth taking where they lower the noise of the whole. Of the first integral all are taken. Of each of the others
a few tell how much noise there is. They are not used otherwise: were their numbers to decide how many others they are added
to, large ones would count less. Sums of integrals that have variances V with as many samples each are the least noisy for
their cost with samples in proportion to sqrt(V / c), c the time of a sample. Looking at all costs as much as many samples:
those that are taken in any case are found together with those that tell the noise, and others only if they are worth it.

Reference: Owen 2013, "Monte Carlo theory, methods and examples", section 8.4 (Neyman allocation).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple, Protocol

import torch
from torch import Tensor

from torch_radbp.boundary.terms.cuts import CutsOfView, joined_cuts
from torch_radbp.boundary.terms.shadow_term import ShadowTerm
from torch_radbp.call.render_call import RenderCall
from torch_radbp.sampling.sampler import SampleKey, hash32

TRIED = 1 / 16  # share of the samples that tell the noise
LEAST = 1 / 4  # share of the samples that are taken in any case
COST = 3.0  # times as long as a sample of the first integral one of the others takes
WORTH = 1 << 16  # paths of an image from which on it is worth trying
SALT = 0x5851F42D  # tells the random numbers of what is tried from others


class SampledIntegral(Protocol):
    """The interface of the samples of one boundary integral."""

    def independent(self) -> Tensor:
        """(3, N) changes of the image if all edges move alike, in independent parts, whose squares sum to the variance."""


class Amount(NamedTuple):
    """The number of samples of an integral, as shares of the greatest number."""

    counted: float = 1.0
    tried: float = 0.0  # additional pilot samples with other random numbers, which only estimate noise
    before: float = 0.0  # samples taken before


ALL = Amount()


def trying(call: RenderCall) -> RenderCall:
    """The call with the random numbers of pilot samples, which only tell how much noise there is."""
    return with_numbers(call, SALT)


def with_numbers(call: RenderCall, salt: int) -> RenderCall:
    """The call with other random numbers, which a salt (a number mixed into their keys) changes."""
    return call.with_views([view._replace(sample_keys=tuple(
        SampleKey(hash32(key.seed ^ salt), key.shared) for key in view.sample_keys)) for view in call.views])


def is_worth_trying(call: RenderCall, number: int) -> bool:
    """True if view `number` has so many samples that dividing them among integrals pays off.

    Shadow borders of lights without extent are single curves, on which samples are spread so evenly that their sum has far
    less noise than independent samples: if there are any, all samples are taken.
    """
    view, lights = call.views[number], call.scene.layout.lights
    return view.width * view.height * call.spp >= WORTH and not any(kind.delta for kind in lights)


def variance(found: SampledIntegral | None) -> float:
    """The variance of an integral's estimate for equal motion of all edges; 0 for None."""
    return 0.0 if found is None else squares(found.independent())


def squares(amounts: Tensor) -> float:
    """The sum of the squares of an integral's finite contributions, (3, N)."""
    return float(torch.where(torch.isfinite(amounts), amounts, 0.0).square().sum())


def effort(first: float, tried: SampledIntegral | None) -> float:
    """The share of the greatest number of samples that an integral is given: more if it is noisy beside the first one.

    Args:
        first: the variance of the first integral, with all of its samples.
        tried: pilot samples of this integral, a share of `TRIED`; None: there are none.
    """
    return min(1.0, max(LEAST, (TRIED * variance(tried) / (COST * first))**0.5)) if first > 0.0 else 1.0


def as_worth(first: float, found: Callable[[Amount], CutsOfView | None]) -> CutsOfView | None:
    """Takes as many samples of an integral as pay off; None: there are none.

    Args:
        first: the variance of the first integral, with all of its samples.
        found: takes samples of the integral, of a given amount.
    """
    some = found(Amount(LEAST, TRIED))
    tried, some = (None, None) if some is None else some.parted()
    worth = effort(first, tried)
    if worth < LEAST + TRIED:  # so few others cost far more than they lower the noise
        return some
    more = found(Amount(worth - LEAST, before=LEAST))
    share = LEAST / worth
    return joined_cuts([(own, share) for own, share in ((some, share), (more, 1.0 - share)) if own is not None])


def samples_of_view(still: RenderCall, number: int, terms: Sequence[ShadowTerm]) -> list[Any]:
    """The samples of each term in a view: for the first all, for the others as many as pay off.

    Args:
        still: the call without derivatives.
        number: of the view.
        terms: the terms of the call.
    """
    found = [term.samples(number) for term in terms[:1]]
    splits = any(term.is_split for term in terms[1:]) and is_worth_trying(still, number)
    first = variance(found[0]) if splits else 0.0
    for term in terms[1:]:
        worth = term.is_split and first > 0.0
        found.append(as_worth(first, partial(term.samples, number)) if worth else term.samples(number))
    return found
