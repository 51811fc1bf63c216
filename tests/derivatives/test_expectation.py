"""Where no silhouette moves, the derivative is that of finite differences with independent samples, in expectation."""

import pytest

from tests.derivatives.in_expectation import Effort, Estimate
from tests.derivatives.moving_scenes import SCENES

FAST = Effort(spp=8, batches=8)


@pytest.mark.parametrize("name", SCENES)
def test_derivatives_are_those_of_finite_differences(name):
    estimate = Estimate(SCENES[name], FAST)
    estimate.add_round()
    for sampling, result in estimate.checks().items():
        reference = result.comparison.difference
        assert reference.isfinite().all() and reference.abs().max() > 0, sampling
        assert result.verdict in ("agrees", "too noisy"), f"{sampling}: {result}"
        for projection in result.comparison.projections:
            assert abs(projection.z) <= 4, f"{sampling}: {result}"
            assert projection.backward_error < 1e-9, f"{sampling}: {result}"
