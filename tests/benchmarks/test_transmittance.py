"""The benchmark of transmittance: its estimators agree with sums over fine steps."""

from __future__ import annotations

import pytest
import torch

from benchmarks.transmittance import by_series, grids, medium_of, rays_through, tracked
from torch_radbp.tensors.vec import Ray

RAYS, REPEATS, STEPS = 64, 80, 400


@pytest.fixture(scope="module")
def measured():
    """The exact transmittance of rays, (N,), and by each estimator values, (repeats, N)."""
    grid = grids(2.0)["haze"]
    ray, length = rays_through(RAYS, torch.Generator().manual_seed(2))
    kind, table = medium_of(grid)
    depth = sum(kind.extinction(table, ray.o + ray.d * ((step + 0.5) / STEPS * length), ray.d).x for step in range(STEPS))
    estimators = {"ratio": tracked(grid, False), "residual ratio": tracked(grid, True), "series": by_series(grid)}
    rays, lengths = Ray(*(part.map(lambda c: c.repeat(REPEATS)) for part in ray)), length.repeat(REPEATS)
    return torch.exp(-depth * length / STEPS), {
        name: estimate(rays, lengths, 0)[0].reshape(REPEATS, RAYS) for name, estimate in estimators.items()}


@pytest.mark.parametrize("name", ["ratio", "residual ratio", "series"])
def test_estimators_have_no_bias(measured, name):
    exact, found = measured[0], measured[1][name]
    means = found.mean(1)  # over the rays
    assert 0.05 < float(exact.mean()) < 0.9
    assert abs(float(means.mean() - exact.mean())) < 4.0 * float(means.std()) / REPEATS**0.5


def test_what_a_cell_has_at_least_makes_no_noise(measured):
    variances = {name: float(found.var(0).mean()) for name, found in measured[1].items()}
    assert 0 < variances["series"] < variances["residual ratio"] < 0.3 * variances["ratio"]
