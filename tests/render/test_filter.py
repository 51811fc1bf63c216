"""Reconstruction filters are drawn from: offsets of samples must have the filter as their density.

Reference: Ernst et al. 2006, "Filter Importance Sampling".
"""

import math

import numpy as np
import pytest
import torch
from scipy import integrate, stats

import torch_radbp as rb
from tests.scenes import load, rectangle, rgb, sensor
from torch_radbp.film.box import Box
from torch_radbp.film.gaussian import Gaussian
from torch_radbp.film.position import quantile
from torch_radbp.film.tent import Tent

FILTERS = {"box": Box(), "wide box": Box(radius=1.5), "tent": Tent(), "narrow tent": Tent(radius=0.4),
           "gaussian": Gaussian(), "wide gaussian": Gaussian(stddev=1.3)}


def offsets(filter, count=100_000):
    u = torch.rand(count, generator=torch.Generator().manual_seed(4), dtype=torch.float64)
    return quantile(filter.table().quantiles, u).numpy()


def density(filter):
    """The filter, normalised, as a function of a float."""
    def value(x):
        return float(filter.evaluate(torch.tensor(x, dtype=torch.float64))) if abs(x) <= filter.radius else 0.0

    total = integrate.quad(value, -filter.radius, filter.radius, points=[0.0])[0]
    assert total > 0
    return lambda x: value(x) / total


@pytest.mark.parametrize("filter", FILTERS.values(), ids=FILTERS)
def test_offsets_follow_the_filter(filter):
    grid = np.linspace(-filter.radius, filter.radius, 2001)
    p = density(filter)
    values = np.array([p(x) for x in grid])
    cdf = np.concatenate([[0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(grid))])
    assert cdf[-1] == pytest.approx(1, abs=1e-5)
    # Kolmogorov-Smirnov; the offsets are fixed, so that this passes or fails for good.
    assert stats.kstest(offsets(filter), lambda x: np.interp(x, grid, cdf)).pvalue > 1e-5


@pytest.mark.parametrize("filter", FILTERS.values(), ids=FILTERS)
def test_the_table_has_the_moments_of_the_filter(filter):
    p = density(filter)
    variance = integrate.quad(lambda x: x * x * p(x), -filter.radius, filter.radius, points=[0.0])[0]
    u = (torch.arange(1 << 16, dtype=torch.float64) + 0.5) / (1 << 16)
    x = quantile(filter.table().quantiles, u)
    assert abs(float(x.mean())) < 1e-9
    assert float(x.var()) == pytest.approx(variance, rel=2e-3)  # linear pieces; the tails are the coarsest
    known = {"box": filter.radius**2 / 3, "tent": filter.radius**2 / 6}
    if filter.type in known:
        assert variance == pytest.approx(known[filter.type], rel=1e-6)


@pytest.mark.parametrize("filter", FILTERS.values(), ids=FILTERS)
def test_offsets_are_symmetric_and_stay_within_the_radius(filter):
    table = filter.table().quantiles
    assert (table[1:] >= table[:-1]).all()
    torch.testing.assert_close(table, -table.flip(0), rtol=0, atol=1e-9)
    assert table.abs().max() <= filter.radius
    largest = quantile(table.float(), torch.tensor([0.0, 1 - 2.0**-24]))
    assert torch.isfinite(largest).all() and largest.abs().max() <= filter.radius


@pytest.mark.parametrize("filter, radius", [({"type": "box"}, 0.5), ({"type": "tent"}, 1.0), ({"type": "gaussian"}, 2.0)],
                         ids=["box", "tent", "gaussian"])
def test_the_edge_of_a_lamp_is_blurred_by_the_filter(filter, radius):
    """Across a straight edge a pixel's value is the filter's cumulative distribution at its distance from the edge."""
    size = 16
    film = {"type": "hdrfilm", "width": size, "height": size, "rfilter": filter}
    tangent = math.tan(math.radians(20))
    lamp = rectangle((-10, 0, 0), (10.0, 20.0, 1.0), emitter={"type": "area", "radiance": rgb(1, 1, 1)})  # all of x < 0
    scene = load(sensor=sensor(size, (0.03, 0, 4), (0.03, 0, 0), 40, film=film), lamp=lamp)
    image = rb.render(scene, spp=256, max_depth=1)[0, 0].mean(0)  # all rows show the same: 4096 samples a column
    edge = size / 2 - 0.03 * size / (2 * 4 * tangent)  # pixels from the left
    p = density({"box": Box(), "tent": Tent(), "gaussian": Gaussian()}[filter["type"]])
    for column in range(size):
        distance = min(max(edge - column - 0.5, -radius), radius)
        expected = integrate.quad(p, -radius, distance, points=[0.0])[0]
        standard_error = math.sqrt(max(expected * (1 - expected), 0) / 4096)
        assert float(image[column]) == pytest.approx(expected, abs=5 * standard_error + 1e-3)  # the table's own error


@pytest.mark.parametrize("make", [lambda: Box(radius=0.0), lambda: Tent(radius=-1.0), lambda: Gaussian(stddev=float("nan"))])
def test_a_filter_without_width_is_refused(make):
    with pytest.raises(ValueError, match="must be greater than 0 and finite"):
        make()
