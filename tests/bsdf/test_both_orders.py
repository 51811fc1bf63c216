"""Differentiate then sample, and sample then differentiate: both estimate the derivative of one integral.

For I(theta) = integral of eval(wi, wo) h(wo) dwo with a smooth h, the detached estimator is the mean of (d eval) h / pdf,
and the attached one the mean of d [eval h / (pdf with fixed lobes)] with everything following wo. Both are
compared with differences of I over common random numbers, which know of no derivative.

Both lobes of glass are followed from every microfacet, each with its probability: near the critical angle the derivative of
a transmittance is so much greater than the transmittance that choosing by it has no finite variance.

Reference: Zeltner et al. 2021, "Monte Carlo Estimators for Differential Light Transport", section 4.
"""

import math
from typing import NamedTuple

import pytest
import torch

from tests.bsdf.lanes import GLASS, MATERIALS, ROUGH, material, numbers, values_of
from torch_radbp.bsdf.kind import Choice, Kind, Values
from torch_radbp.vec import Vec3

COUNT = 60_000
STEP = 1e-4


def light(wo: Vec3) -> torch.Tensor:
    """Smooth radiance from all sides, without symmetry."""
    return torch.exp(0.8 * wo.x - 0.5 * wo.y + 0.6 * wo.z) + 0.3 * torch.sin(3 * wo.x + 2 * wo.y * wo.z)


class Setting(NamedTuple):
    """A material seen from a direction, at theta."""

    kind: Kind
    values: Values
    wi: Vec3


def setting(name: str, what: str, theta: torch.Tensor, z: float) -> Setting:
    """The material `name` on lanes; `what` is moved by `theta` (N,), wi by turning it towards the normal."""
    bsdf = material(MATERIALS[name])
    kind, values = bsdf.kind(), list(values_of(bsdf, theta))
    moved = {"roughness": range(1 + kind.anisotropic), "eta": [len(values) - 3], "wi": []}[what]
    for slot in moved:
        values[slot] = values[slot].map(lambda c: c + theta)
    polar = math.acos(z) - (theta if what == "wi" else 0 * theta)
    return Setting(kind, tuple(values), Vec3(torch.sin(polar) * math.cos(0.4), torch.sin(polar) * math.sin(0.4),
                                             torch.cos(polar)))


def lobes(name: str, at: Setting, random) -> list[Choice]:
    """Each choice that a microfacet leaves, with its probability."""
    share = at.kind.choose(at.values, at.wi, torch.zeros_like(random.u), random.u, random.v).probability
    reflection = Choice(torch.zeros_like(share), share)
    return [reflection, Choice(torch.ones_like(share), 1 - share)] if name in GLASS else [reflection]


def integral(name: str, what: str, theta: float, z: float, random) -> float:
    """I(theta), from samples of the material at theta."""
    at = setting(name, what, torch.full_like(random.u, theta), z)
    total = 0.0
    for choice in lobes(name, at, random):
        wo = at.kind.sample(at.values, at.wi, choice, random.u, random.v)
        pdf = at.kind.pdf(at.values, at.wi, wo)
        weight = at.kind.eval(at.values, at.wi, wo).y * light(wo) / torch.where(pdf > 0, pdf, 1.0)
        total += (weight * choice.probability).mean().item()
    return total


@pytest.mark.parametrize("z", [0.8, -0.85])
@pytest.mark.parametrize("what", ["roughness", "eta", "wi"])
@pytest.mark.parametrize("name", ROUGH)
def test_both_orders_agree_with_differences(name, what, z):
    if z < 0 and name not in GLASS:
        pytest.skip("black from behind")
    random = numbers(COUNT)
    expected = (integral(name, what, STEP, z, random) - integral(name, what, -STEP, z, random)) / (2 * STEP)
    theta = torch.zeros(COUNT, dtype=torch.float64, requires_grad=True)
    at = setting(name, what, theta, z)
    slopes = torch.zeros(2, COUNT, dtype=torch.float64)
    for choice in lobes(name, at, random):
        wo = at.kind.sample(at.values, at.wi, choice, random.u, random.v)
        fixed = wo.detach()
        pdf = at.kind.pdf(at.values, at.wi, fixed).detach()
        dead = ((pdf == 0) | (choice.probability == 0)).double()
        detached = at.kind.eval(at.values, at.wi, fixed).y * light(fixed) / (pdf + dead)
        moving = at.kind.eval_pdf(at.values, at.wi, wo, fixed_lobes=True)[1]
        attached = at.kind.eval(at.values, at.wi, wo).y * light(wo) / (moving + dead)
        for row, estimate in enumerate((detached, attached)):
            torch.testing.assert_close((estimate * (1 - dead)).detach(), (detached * (1 - dead)).detach(), rtol=1e-4,
                                       atol=1e-9)  # one value, two derivatives
            weight = choice.probability * (1 - dead)
            slopes[row] += torch.autograd.grad((estimate * weight).sum(), theta, retain_graph=True)[0]
    assert abs(expected) > 1e-3
    mean, error = slopes.mean(1), slopes.std(1) / math.sqrt(COUNT)
    # On the numbers of the differences, whose lobes the attached samples follow: equal up to kinks, at horizons
    # (and at the critical angle, where the difference quotient has noise of its own).
    assert abs(mean[1] - expected) < 0.01 * abs(expected) + 3 * error[1]
    difference = slopes[0] - slopes[1]
    assert abs(difference.mean()) < 4.5 * difference.std() / math.sqrt(COUNT) + 1e-12
    assert error[0] < 0.5 and error[1] < 0.5
