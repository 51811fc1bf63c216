"""Differentiate then sample, and sample then differentiate: both estimate the derivative of one integral.

For I(theta) = integral of eval(wi, wo) h(wo) dwo with a smooth h, the detached estimator is the mean of (d eval) h / pdf,
and the attached one the mean of d [eval h / (pdf with fixed lobes)] with everything following wo; delta lobes add their
weight times h in the direction that follows. Both are compared with differences of I over common random numbers, which know
of no derivative.

All lobes are followed, each with its probability, those of glass from every microfacet: near the critical angle the
derivative of a transmittance is so much greater than the transmittance that choosing by it has no finite variance.

Reference: Zeltner et al. 2021, "Monte Carlo Estimators for Differential Light Transport", section 4.
"""

import math
from typing import NamedTuple

import pytest
import torch

from tests.bsdf.lanes import KINDS, ROUGH, choices, light, material, random_numbers, values_of
from tests.deep import deep_but_every
from tests.scenes.materials import MATERIALS
from torch_radbp.interface.bsdf import Kind, LobeChoice, Values
from torch_radbp.tensors.vec import Vec3, where

COUNT = 60_000
STEP = 1e-4


def slots(name: str, what: str) -> list[int]:
    """The numbers of the values that belong to a parameter."""
    if what == "wi":
        return []
    bsdf = material(MATERIALS[name])
    own = [getattr(texture, "place", (bsdf, ""))[1] for texture in bsdf.textures()]
    if what == "eta":
        return [k for k, texture in enumerate(bsdf.textures()) if own[k] == "eta" or texture is getattr(bsdf, "eta", None)]
    return [k for k, attribute in enumerate(own) if attribute == what or (what == "alpha" and "alpha_" in attribute)]


WHAT = ("alpha", "eta", "weight", "opacity", "roughness", "anisotropic", "metallic", "spec_trans", "specular", "spec_tint",
        "sheen", "sheen_tint", "clearcoat", "clearcoat_gloss", "flatness", "diff_trans", "wi")
IN_FRONT = ("spec_tint", "sheen", "sheen_tint", "clearcoat", "clearcoat_gloss", "flatness")
# Without shadowing, and in a film, the BSDF jumps where attached directions slide.
CASES = [(name, what, z) for name in ROUGH if name not in ("brushed bumps", "film", "sheet with all")
         for what in WHAT if what == "wi" or slots(name, what)
         if name != "principled with all" or what in ("roughness", "clearcoat_gloss", "wi")  # others have the rest
         for z in (0.8, -0.85) if z > 0 or (name != "mask" and KINDS[name].transmits  # else black from behind
                                            and not (what in IN_FRONT and "principled" in name))]


class Setting(NamedTuple):
    """A material seen from a direction, at theta."""

    kind: Kind
    values: Values
    wi: Vec3


def setting(name: str, what: str, theta: torch.Tensor, z: float) -> Setting:
    """The material `name` on lanes; `what` is moved by `theta` (N,), wi by turning it towards the normal."""
    bsdf = material(MATERIALS[name])
    kind, values = bsdf.kind(), list(values_of(bsdf, theta))
    for slot in slots(name, what):
        values[slot] = values[slot].map(lambda c: c + theta)
    polar = math.acos(z) - (theta if what == "wi" else 0 * theta)
    return Setting(kind, tuple(values), Vec3(torch.sin(polar) * math.cos(0.4), torch.sin(polar) * math.sin(0.4),
                                             torch.cos(polar)))


class Estimate(NamedTuple):
    """BSDF times cosine over density, of the smooth lobes together or of the delta lobe that was chosen."""

    value: torch.Tensor
    density: torch.Tensor
    alive: torch.Tensor  # 0 or 1


def estimate(at: Setting, choice: LobeChoice, wo: Vec3, fixed_lobes: bool = False) -> Estimate:
    """The terms of F at a sampled direction; of a delta lobe both are weights, whose density moves with the direction."""
    value, pdf = at.kind.eval_pdf(at.values, at.wi, wo, fixed_lobes)
    value = value.y
    chance = at.kind.chance_by_direction(tuple(v.detach() for v in at.values), at.wi, wo, choice) if fixed_lobes else None
    if chance is not None:
        chance = chance.clamp_min(1e-15)
        pdf = pdf * chance.detach() / chance
    if at.kind.delta:
        ideal = choice.is_delta(at.kind)
        value = torch.where(ideal, at.kind.specular(at.values, at.wi, choice).y, value)
        pdf = torch.where(ideal, choice.probability, pdf)
    alive = ((pdf > 0) & (choice.probability > 0)).double()
    return Estimate(value, pdf * alive + (1 - alive), alive)


def integral(name: str, what: str, theta: float, z: float, random) -> float:
    """I(theta), from samples of the material at theta."""
    at = setting(name, what, torch.full_like(random.u, theta), z)
    total = 0.0
    for choice in choices(at.kind, at.values, at.wi, random):
        wo = at.kind.sample(at.values, at.wi, choice, random.u, random.v)
        value, density, alive = estimate(at, choice, wo)
        total += (value * light(wo) / density * alive * choice.probability).mean().item()
    return total


@pytest.mark.parametrize("name, what, z", deep_but_every(20, CASES))
def test_both_orders_agree_with_differences(name, what, z):
    random = random_numbers(COUNT)
    expected = (integral(name, what, STEP, z, random) - integral(name, what, -STEP, z, random)) / (2 * STEP)
    theta = torch.zeros(COUNT, dtype=torch.float64, requires_grad=True)
    at = setting(name, what, theta, z)
    slopes = torch.zeros(2, COUNT, dtype=torch.float64)
    for choice in choices(at.kind, at.values, at.wi, random):
        moving = at.kind.sample(at.values, at.wi, choice, random.u, random.v)
        # The directions of delta lobes are always followed.
        still = where(choice.is_delta(at.kind), moving, moving.detach())
        for row, (wo, fixed_lobes) in enumerate(((still, False), (moving, True))):
            value, density, alive = estimate(at, choice, wo, fixed_lobes)
            estimated = value * light(wo) / (density if fixed_lobes else density.detach()) * alive
            if row == 0:
                reference = estimated.detach()
            torch.testing.assert_close(estimated.detach(), reference, rtol=1e-4, atol=1e-9)  # one value, two derivatives
            slopes[row] += torch.autograd.grad((estimated * choice.probability).sum(), theta, retain_graph=True)[0]
    assert abs(expected) > 1e-4  # rounding of the difference is 1e-11
    mean, error = slopes.mean(1), slopes.std(1) / math.sqrt(COUNT)
    # On the numbers of the differences, whose lobes the attached samples follow: equal up to kinks, at horizons
    # (and at the critical angle, where the difference quotient has noise of its own).
    assert abs(mean[1] - expected) < 0.01 * abs(expected) + 3 * error[1]
    difference = slopes[0] - slopes[1]
    assert abs(difference.mean()) < 4.5 * difference.std() / math.sqrt(COUNT) + 1e-12
    assert error[0] < 0.5 and error[1] < 0.5
