"""Light found by chance and light found by next-event estimation, weighted against it, have the same expectation.

Reference: Veach 1997, section 9.2: weights that sum to one. Images that look alike can hide a quarter of the light, hence
one test per kind of light and depth.
"""

import math

import pytest
import torch

import torch_radbp as rb
from tests.deep import deep
from tests.scenes import CASES

LIGHTS = ("cornell", "repeat_bilinear", "two_sided", "textured_lamp")
BLOCK = 4  # pixels; light found by chance is noisy


def blocks(scene, seeds, **settings):
    """(R, 3, 2, 2) means over blocks of pixels, one image per seed."""
    renderer = rb.Renderer(scene, **settings)
    images = torch.cat([renderer(seed=seed) for seed in seeds])
    return torch.nn.functional.avg_pool2d(images, BLOCK)


@pytest.mark.parametrize("name, depth", [("cornell", 2), *((name, 4) for name in LIGHTS),
                                         *(deep(name, 2) for name in LIGHTS if name != "cornell")])
def test_next_event_estimation_does_not_change_the_expectation(name, depth):
    settings = {"max_depth": depth, "rr_depth": 100}
    scene = CASES[name].scene()
    by_chance = blocks(scene, range(16), nee=False, spp=512, **settings)
    with_nee = blocks(scene, range(100, 116), nee=True, spp=512, **settings)
    standard_error = ((by_chance.var(0) + with_nee.var(0)) / 16).sqrt()
    mean, difference = by_chance.mean(0), with_nee.mean(0) - by_chance.mean(0)
    assert (mean > 0).all() and (standard_error > 0).all()
    # 12 numbers, about 20 degrees of freedom: beyond 5.5 by chance in one run of 4000; the seeds are fixed.
    assert (difference.abs() / standard_error).max() < 5.5
    # The mean image is known well enough that a missing twentieth would show.
    assert difference.mean().abs() < 0.05 * mean.mean()
    assert standard_error.square().sum().sqrt() / math.sqrt(12) < 0.05 * mean.mean()


@pytest.mark.parametrize("name", ["cornell", "two_sided", "sky_and_points"])
def test_roulette_does_not_change_the_expectation(name):
    scene = CASES[name].scene()
    without = blocks(scene, range(16), max_depth=5, rr_depth=100, spp=32)
    with_roulette = blocks(scene, range(100, 116), max_depth=5, rr_depth=1, spp=64)
    standard_error = ((without.var(0) + with_roulette.var(0)) / 16).sqrt()
    difference = with_roulette.mean(0) - without.mean(0)
    assert (standard_error > 0).all()
    assert (difference.abs() / standard_error).max() < 5.5
    assert difference.mean().abs() < 0.05 * without.mean()
