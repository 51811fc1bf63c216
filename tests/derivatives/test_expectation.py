"""Where no silhouette moves, the derivative is that of finite differences with independent samples, in expectation."""

import numpy as np
import pytest
import torch

import torch_radbp as rb
from tests.derivatives.in_expectation import Effort, Estimate
from tests.derivatives.moving_scenes import FLOOR, SCENES, TURN, rigid, scene, sensor
from torch_radbp.io.transform import rotate

pytestmark = pytest.mark.filterwarnings("ignore::torch_radbp.SilhouetteWarning")
FAST = Effort(spp=16, batches=8)


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


@pytest.mark.parametrize("name", [name for name in SCENES if name.startswith(("lens", "mirror", "pane"))])
def test_where_all_is_ideally_specular_hybrid_is_attached(name):
    """Sample by sample: no direction is left to chance."""
    moving = SCENES[name]
    build = moving.build().double()
    tangent = moving.tangent(build)
    hybrid, attached = (rb.jvp(build, {moving.name: tangent}, spp=4, max_depth=moving.max_depth, sampling=sampling)
                        for sampling in ("hybrid", "attached"))
    assert attached.isfinite().all() and attached.abs().max() > 1e-3
    assert (hybrid - attached).abs().max() < 1e-12 * attached.abs().max()


def test_attached_directions_pass_the_cells_of_an_environment_map_without_a_jump():
    """The density that picks directions jumps at the border of a bright block; weights that did would bias this by 7%."""
    bright = np.full((16, 32, 3), 0.1)
    bright[3:6, 8:14] = 20
    sky = {"type": "envmap", "bitmap": bright, "to_world": rotate((0.3, 1, 0.4), 40) @ rotate((1, 0, 0), 90)}
    build = scene(sensor=sensor(2, (0.5, -0.4, 2.6), (0.1, 0.15, 0), 40), **FLOOR, sky=sky)()
    tangent = rigid(TURN)(build.get_parameter("plane.to_world"))
    estimates = []
    for first, sampling in enumerate(("hybrid", "attached")):
        estimates.append(torch.stack([
            rb.jvp(build, {"plane.to_world": tangent}, spp=2048, max_depth=2, seed=100 * first + k, sampling=sampling).mean()
            for k in range(12)]))
    glued, attached = (estimate.mean() for estimate in estimates)
    error = torch.stack([estimate.var() / len(estimate) for estimate in estimates]).sum().sqrt()
    assert 4 * error < 0.05 * glued.abs()  # so that it can fail
    assert (attached - glued).abs() < 4 * error, (attached, glued, error)
