"""Reconstruction filters by their formulas: values that were worked out by hand, and where most of them end."""

import math

import pytest
import torch

from torch_radbp.plugin import REGISTRY

GAUSSIAN_END = math.exp(-8)  # what a Gaussian has at 4 standard deviations, by which it is lowered
KNOWN = {  # values at places, up to a common factor; from Mitchell and Netravali 1988, equation 8, for the cubic ones
    "box": {0.0: 1.0, 0.49: 1.0},
    "tent": {0.0: 1.0, 0.25: 0.75, -0.5: 0.5, 1.01: 0.0},
    "gaussian": {0.0: 1 - GAUSSIAN_END, 0.5: math.exp(-0.5) - GAUSSIAN_END, -1.0: math.exp(-2) - GAUSSIAN_END,
                 1.9: math.exp(-7.22) - GAUSSIAN_END, 2.0: 0.0, 2.1: 0.0},
    "mitchell": {0.0: 8 / 9, 0.5: 77 / 144, 1.0: 1 / 18, -1.5: -5 / 144, 2.1: 0.0},
    "catmullrom": {0.0: 1.0, 0.5: 9 / 16, 1.0: 0.0, 1.5: -1 / 16, 2.1: 0.0},
    "lanczos": {0.0: 1.0, 0.5: math.sin(math.pi / 2) * math.sin(math.pi / 6) / (math.pi**2 / 12), 1.0: 0.0,
                -1.5: math.sin(1.5 * math.pi) * math.sin(math.pi / 2) / (0.75 * math.pi**2), 3.1: 0.0},
}


@pytest.mark.parametrize("name", REGISTRY["rfilter"])
def test_values_are_those_of_the_formula(name):
    places = torch.tensor(list(KNOWN[name]), dtype=torch.float64)
    expected = torch.tensor(list(KNOWN[name].values()), dtype=torch.float64)
    found = REGISTRY["rfilter"][name]().evaluate(places)
    assert found.abs().max() > 0
    torch.testing.assert_close(found * expected[0] / found[0], expected, rtol=1e-12, atol=1e-12)
