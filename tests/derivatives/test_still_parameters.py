"""Derivatives by parameters that move nothing are those of finite differences with independent samples, in expectation.

The list is what the code registers. Parameters that move something have scenes of their own in `test_expectation.py`.
"""

from typing import Any

import pytest
import torch

import torch_radbp as rb
from tests.derivatives.in_expectation import Effort, Estimate
from tests.scenes import load
from tests.scenes.everything import objects
from tests.scenes.pairs import registered
from tests.scenes.quiet import MORE, examples, is_still, still_scene

SENSORS = 8  # independent batches
SPP = 64  # of each
BIAS = 0.05  # relative, that must be noticed
# Where rare choices decide: a lobe, a light, a part of the sky.
NOISY_SPP, NOISY_BIAS = 2048, 0.1
NOISY = ("pane", "dielectric", "blend", "blend of deltas", "mask", "plastic", "twosided", "sunsky", "trilinear bumps",
         "rough glass beckmann", "brushed glass beckmann", "homogeneous", "fog by a table", "fog of two kinds",
         "heterogeneous", "smoke of three colours", "flame", "glowing fog")
ROWS = [*((examples().get(pair), str(pair)) for pair in sorted(registered()) if is_still(pair)),
        *((example, str(example)) for example in MORE)]
SMOKE = "heterogeneous"  # which takes longest, and which tests/medium compares with differences
SOME = [pytest.param(example, id=name, marks=[pytest.mark.deep] * (place % 16 != 8 or example.scene == SMOKE))
        for place, (example, name) in enumerate(ROWS)]


@pytest.mark.parametrize("example", SOME)
def test_derivatives_are_those_of_finite_differences(example):
    """And if they were wrong by twice the stated bias, that would be noticed."""
    assert example, "no scene of tests/scenes/every_plugin.py has this parameter in its subject: add one"
    spp, bias = (NOISY_SPP, NOISY_BIAS) if example.scene in NOISY else (SPP, BIAS)
    # Eager, as the scenes have little in common.
    measured = Estimate(still_scene(example, SENSORS), Effort(spp, SENSORS, compile=False, backward=False))
    measured.add_round()
    result = measured.checks()["hybrid"]
    reference = result.comparison.difference
    assert reference.isfinite().all() and reference.abs().max() > 0
    assert not result.verdict.startswith("biased"), str(result)
    assert result.detectable < bias, str(result)
    for error in (2 * bias, -2 * bias):
        assert measured.checks(error)["hybrid"].verdict.startswith("biased"), error


def sharp(part: Any) -> Any:
    """What describes a part of a scene, its images without their pyramids."""
    if isinstance(part, dict):
        return {key: "bilinear" if key == "filter_type" else sharp(value) for key, value in part.items()}
    return part


@pytest.mark.parametrize("name", [example.scene for example in MORE])
def test_pyramids_are_read_above_their_first_level(name):
    image, expected = (rb.render(load(torch.float64, **parts), spp=16, max_depth=2) for parts in (
        sharp(objects(name)), objects(name)))
    assert expected.max() > 0 and (image - expected).abs().max() > 0.02 * expected.max()
