"""Tests whether a material is reciprocal, and conserves energy.

For radiance, f(wi, wo) / n_i^2 = f(wo, wi) / n_o^2 with the indices of refraction n (Veach 1997, equation 5.14). Of pairs on
one side the two must be equal; of pairs that cross, the quotient must be the same for all. That is the squared index, which
power is computed with from radiance.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.bsdf.contract import CheckedKind
from torch_radbp.check.lanes import LaneNumbers, choices, direction, directions, random_numbers, sampled, weight_of
from torch_radbp.check.report import Finding
from torch_radbp.check.scattering import SIGMAS, VIEWERS, Subject
from torch_radbp.check.sphere import AZIMUTH
from torch_radbp.interface.bsdf import Kind, Values
from torch_radbp.tensors.vec import Vec3, dot

SAME = 1e-6  # relative, to rounding
SMALL = 1e-9  # of the largest value; what is smaller is rounding or underflow
BACK = 1e-9  # of the distance between unit vectors that count as the same direction, squared
LEEWAY = 0.02  # of energy, for parts of models that are fitted, such as Beckmann's shadowing, or inside of a coat


def claims(kind: Kind | CheckedKind, name: str) -> bool:
    """True if a BSDF and all nested in it declare the property `name`, `reciprocal` or `conserves`."""
    kind = kind.kind if isinstance(kind, CheckedKind) else kind
    held = [getattr(kind, field.name) for field in dataclasses.fields(kind)]
    return bool(getattr(kind, name)) and all(claims(part, name) for part in held if isinstance(part, Kind))


class Balance(NamedTuple):
    """The comparison of a BSDF for pairs of directions with itself for the reversed pairs."""

    asymmetry: float  # largest relative difference of pairs; for pairs that cross, after division by the squared index
    squared_index: float  # of refraction, inside relative to outside
    pairs: int  # number of pairs with any scattering


def compared(one_way: Tensor, other_way: Tensor, crossing: Tensor, root: bool) -> Balance:
    """Compares the BSDF from a to b with that from b to a, (N, 3) each; a is outside where the pair crosses, (N,) bool.

    `root`: the quotient of crossing pairs is the index of refraction to the fourth power, as for delta lobes, not squared.
    """
    forth, back = one_way[crossing].flatten(), other_way[crossing].flatten()
    quotient = float((forth * back).sum() / (forth * forth).sum()) if bool((forth > 0).any()) else 1.0
    expected = torch.where(crossing[:, None], quotient * one_way, one_way)
    size = torch.maximum(expected.abs(), other_way.abs())
    there = ~(size <= SMALL * size.max()) if size.numel() else size.bool()  # what is not finite among them
    off = ((expected - other_way).abs() / size)[there]
    return Balance(float(off.max()) if len(off) else 0.0, quotient ** (0.5 if root else 1.0), int(there.any(1).sum()))


def smooth_balance(subject: Subject, count: int, seed: int) -> Balance:
    """Tests the reciprocity of smooth lobes, for random pairs of directions."""
    kind, a, b = subject.kind, directions(count, seed), directions(count, seed + 1)
    turn = (a.z < 0) & (b.z > 0)  # so that a is outside where the pair crosses
    a, b = (Vec3(*(torch.where(turn, y, x) for x, y in zip(*pair))) for pair in ((a, b), (b, a)))
    values = subject.values(a.z)
    there, back = (kind.eval_pdf(values, wi, wo)[0].stack().detach() / wo.z.abs()[:, None] for wi, wo in ((a, b), (b, a)))
    return compared(there, back, (a.z > 0) & (b.z < 0), False)


def delta_balance(subject: Subject, count: int, seed: int) -> Balance:
    """Tests the reciprocity of delta lobes, by light that is sent back the way that it came."""
    kind, wi, random = subject.kind, directions(count, seed), random_numbers(count, seed)
    wi = Vec3(wi.x, wi.y, wi.z.abs())
    values = subject.values(wi.z)
    choice, wo = sampled(kind, values, wi, random)
    ideal = choice.is_delta(kind)
    there, back = (ideal_weight(kind, values, *pair, random)[ideal] for pair in ((wi, wo), (wo, wi)))
    return compared(there, back, (wi.z * wo.z < 0)[ideal], True)


def ideal_weight(kind: CheckedKind | Kind, values: Values, wi: Vec3, wo: Vec3, random: LaneNumbers) -> Tensor:
    """(N, 3) the weight of all delta lobes that scatter from wi to wo."""
    weight = torch.zeros(len(wi.z), 3, dtype=wi.z.dtype)
    for choice in choices(kind, values, wi, random):
        off = kind.sample(values, wi, choice, random.u, random.v) - wo
        is_wo = (dot(off, off) < BACK) & choice.is_delta(kind) & (choice.probability > 0)
        weight = weight + kind.specular(values, wi, choice).stack().detach() * is_wo[:, None]
    return weight


def balances(subject: Subject, count: int, seed: int) -> list[Balance]:
    """Tests the reciprocity of a material's smooth lobes and of its delta lobes, if it has any."""
    return [*([smooth_balance(subject, count, seed)] if subject.kind.smooth else []),
            *([delta_balance(subject, count, seed)] if subject.kind.delta else [])]


def reciprocity(balances: list[Balance], claimed: bool) -> Finding:
    """The finding on reciprocity; if the material does not claim to be reciprocal, only figures without a verdict."""
    off, pairs = max(balance.asymmetry for balance in balances), sum(balance.pairs for balance in balances)
    figures = f"f(wi, wo) and f(wo, wi) differ by up to {off:.2g} of {pairs} pairs"
    return Finding("reciprocity", off <= SAME or not claimed, figures if claimed else f"not claimed; {figures}")


def _power(subject: Subject, z: float, squared_index: float, count: int, seed: int) -> tuple[Tensor, Tensor]:
    """The albedo, (3,), seen from the cosine z, and its standard error; in transmission divided by the squared index."""
    kind, wi = subject.kind, direction(z, AZIMUTH, count)
    values = subject.values(wi.z)
    sample = sampled(kind, values, wi, random_numbers(count, seed))
    weight = weight_of(kind, values, wi, sample).stack().detach()
    change = squared_index if z > 0 else 1.0 / squared_index
    weight = weight * torch.where(wi.z * sample.wo.z < 0, change, 1.0).detach()[:, None]
    return weight.mean(0), weight.std(0) / count**0.5


def energy(subjects: dict[str, Subject], balances: list[Balance], claimed: bool, count: int, seed: int) -> Finding:
    """The finding on energy conservation, for several variants of a material, named by the keys."""
    crossing = [balance.squared_index for balance in balances if balance.squared_index != 1.0]
    squared_index = crossing[0] if crossing else 1.0
    excess, words = [], []
    for name, subject in subjects.items():
        shares = [_power(subject, z, squared_index, count, seed) for z in VIEWERS.values()]
        means, errors = (torch.stack(parts) for parts in zip(*shares))
        words.append(f"{name} at most {float(means.max()):.4f} of the light leaves")
        excess += ((means - 1.0) / (LEEWAY + SIGMAS * errors)).flatten().tolist()
    figures = ", ".join(words)
    holds = all(each <= 1.0 for each in excess) or not claimed
    return Finding("energy", holds, figures if claimed else f"not claimed; {figures}")
