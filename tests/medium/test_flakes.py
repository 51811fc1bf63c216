"""Light that flakes scatter several times is that of a simulation which shares nothing with ours.

Mitsuba 3.9.1 is no witness here: its `sggx` samples other directions than its density says, see
`python -m benchmarks.media_flakes`.
"""

from __future__ import annotations

import math

import pytest
import torch

import torch_radbp as rb
from tests.deep import deep
from tests.scenes.flakes import ball, simulated, sky_pixels

BATCHES, WIDTH, SPP = 12, 8, 256


@pytest.mark.parametrize("depth, paths", [(12, 80_000), deep(2, 400_000), deep(3, 400_000)])
def test_flakes_scatter_as_often_as_a_simulation(depth, paths):
    expected, error = simulated(paths, depth, seed=depth)
    assert 0.4 < expected < 0.8 and error < 0.0015
    scene = rb.load_dict(ball(WIDTH, depth) | {"sky": {"type": "envmap", "bitmap": sky_pixels()}})
    with torch.no_grad():
        means = torch.stack([rb.render(scene, seed=seed, spp=SPP).mean() for seed in range(BATCHES)]).double()
    assert abs(means.mean() - expected) < 4 * math.hypot(error, means.std() / math.sqrt(BATCHES))
