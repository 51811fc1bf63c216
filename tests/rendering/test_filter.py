"""What an image shows of an edge is the integral of the reconstruction filter up to it."""

import math

import pytest
import torch
from scipy import integrate

from tests.film.straight_edge import SIZE, columns_at_an_edge
from torch_radbp.film.box import Box
from torch_radbp.film.gaussian import Gaussian
from torch_radbp.film.tent import Tent


def density(filter):
    """The filter, normalised, as a function of a float."""
    def value(x):
        return float(filter.evaluate(torch.tensor(x, dtype=torch.float64))) if abs(x) <= filter.radius else 0.0

    total = integrate.quad(value, -filter.radius, filter.radius, points=[0.0])[0]
    assert total > 0
    return lambda x: value(x) / total


@pytest.mark.parametrize("filter, radius", [({"type": "box"}, 0.5), ({"type": "tent"}, 1.0), ({"type": "gaussian"}, 2.0)],
                         ids=["box", "tent", "gaussian"])
def test_the_edge_of_a_lamp_is_blurred_by_the_filter(filter, radius):
    """Across a straight edge a pixel's value is the filter's cumulative distribution at its distance from the edge."""
    image, edge = columns_at_an_edge(rfilter=filter)
    p = density({"box": Box(), "tent": Tent(), "gaussian": Gaussian()}[filter["type"]])
    for column in range(SIZE):
        distance = min(max(edge - column - 0.5, -radius), radius)
        expected = integrate.quad(p, -radius, distance, points=[0.0])[0]
        standard_error = math.sqrt(max(expected * (1 - expected), 0) / 4096)
        assert float(image[column]) == pytest.approx(expected, abs=5 * standard_error + 1e-3)  # the table's own error


@pytest.mark.parametrize("make", [lambda: Box(radius=0.0), lambda: Tent(radius=-1.0), lambda: Gaussian(stddev=float("nan"))])
def test_a_filter_without_width_is_refused(make):
    with pytest.raises(ValueError, match="must be greater than 0 and finite"):
        make()
