"""Phase functions integrate to one, are sampled by their density, and have the mean cosines that they are known for."""

from __future__ import annotations

import math

import pytest
import torch

from torch_radbp.plugin import REGISTRY
from torch_radbp.tensors.vec import Vec3, dot

# With the mean of the cosine and of its square; Henyey and Greenstein: g, and 1/3 + 2/3 g^2.
CASES = {
    "isotropic": ({}, 0.0, 1 / 3), "rayleigh": ({}, 0.0, 0.4), "hg": ({}, 0.8, (1 + 2 * 0.64) / 3),
    "hg backwards": ({"g": -0.4}, -0.4, (1 + 2 * 0.16) / 3), "hg even": ({"g": 0.0}, 0.0, 1 / 3),
    "hg nearly even": ({"g": 9e-4}, 9e-4, 1 / 3), "hg sharp": ({"g": 0.9}, 0.9, (1 + 2 * 0.81) / 3),
}


def made(name):
    settings, *_ = CASES[name]
    phase = REGISTRY["phase"][name.split()[0]](**settings).double()
    row = phase.row()
    return phase, type(row)(*(column.reshape(1) for column in row)) if row else row


def test_every_phase_function_has_a_row():
    assert {name.split()[0] for name in CASES} == set(REGISTRY["phase"])


@pytest.mark.parametrize("name", CASES)
def test_it_integrates_to_one_with_the_moments_that_it_is_known_for(name):
    phase, row = made(name)
    cosine = torch.linspace(-1, 1, 400001, dtype=torch.float64)
    value, pdf = phase.kind().eval_pdf(row, cosine)
    assert torch.equal(value, pdf) and (value > 0).all()
    for power, expected in enumerate((1.0, *CASES[name][1:])):
        assert float(torch.trapezoid(2 * math.pi * value * cosine**power, cosine)) == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("name", CASES)
def test_cosines_are_sampled_by_the_density(name):
    """The sampled cosine at u is where the cumulative distribution is u, or 1 - u."""
    phase, row = made(name)
    u = torch.linspace(0.001, 0.999, 997, dtype=torch.float64)
    found = phase.kind().sample(row, u)
    grid = torch.linspace(-1, 1, 4000001, dtype=torch.float64)
    below = torch.cumulative_trapezoid(2 * math.pi * phase.kind().eval_pdf(row, grid)[0], grid)
    reached = below[((found + 1) * 2000000).round().long().clamp(1, 4000000) - 1]
    falls = bool(found[0] > found[-1])
    torch.testing.assert_close(reached, 1 - u if falls else u, rtol=0, atol=1e-4)


@pytest.mark.parametrize("name", CASES)
def test_directions_turn_by_the_sampled_cosine(name):
    phase, row = made(name)
    u, v = torch.rand(2, 64, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    d = torch.nn.functional.normalize(torch.linspace(-1, 1, 192, dtype=torch.float64).view(64, 3) + 0.1, dim=1)
    wo = phase.kind().direction(row, Vec3.of(d), u, v)
    torch.testing.assert_close(dot(wo, wo), torch.ones_like(u))
    torch.testing.assert_close(dot(wo, Vec3.of(d)), phase.kind().sample(row, u))


def test_its_parameters_have_derivatives():
    phase, _ = made("hg")
    g = phase.g.requires_grad_()
    cosine = torch.tensor([-0.5, 0.9], dtype=torch.float64)

    def value(g):
        return phase.kind().eval_pdf(type(phase.row())(g.reshape(1)), cosine)[0]

    assert torch.autograd.gradcheck(value, [g])


def test_a_mean_cosine_of_one_is_refused():
    with pytest.raises(ValueError, match="g must be"):
        REGISTRY["phase"]["hg"](g=1.0)
