"""Derivatives by parameters that move nothing are those of finite differences with independent samples, in expectation.

The list is what the code registers. Parameters that move something have scenes of their own in `test_expectation.py`.
"""

import functools
from typing import Any

import pytest
import torch

import torch_radbp as rb
from tests.derivatives.everything import objects
from tests.derivatives.in_expectation import Effort, Estimate
from tests.derivatives.pairs import registered
from tests.derivatives.quiet_scenes import MORE, Example, examples, is_still, still_scene
from tests.scenes import load
from torch_radbp.check.outcome import GradientCheck

SENSORS = 8  # independent batches
SPP = 64  # of each
BIAS = 0.05  # relative, that must be noticed
# Where rare choices decide: a lobe, a light, a part of the sky.
NOISY_SPP, NOISY_BIAS = 512, 0.1
NOISY = ("pane", "dielectric", "blend", "blend of deltas", "mask", "plastic", "twosided", "sunsky", "trilinear bumps",
         "rough glass beckmann", "brushed glass beckmann")
ROWS = [*(pytest.param(examples().get(pair), id=str(pair)) for pair in sorted(registered()) if is_still(pair)),
        *(pytest.param(example, id=str(example)) for example in MORE)]


@functools.cache
def measured(example: Example) -> Estimate:
    """Rendered once for both tests. Eager, as the scenes have little in common."""
    spp = NOISY_SPP if example.scene in NOISY else SPP
    estimate = Estimate(still_scene(example, SENSORS), Effort(spp, SENSORS, compile=False, backward=False))
    estimate.add_round()
    return estimate


def bias(example: Example) -> float:
    return NOISY_BIAS if example.scene in NOISY else BIAS


def check(example: Example, error: float = 0.0) -> GradientCheck:
    return measured(example).checks(error)["hybrid"]


@pytest.mark.parametrize("example", ROWS)
def test_derivatives_are_those_of_finite_differences(example):
    assert example, "no scene of tests/derivatives/scenes.py has this parameter in its subject: add one"
    result = check(example)
    reference = result.comparison.difference
    assert reference.isfinite().all() and reference.abs().max() > 0
    assert not result.verdict.startswith("biased"), str(result)
    assert result.detectable < bias(example), str(result)


@pytest.mark.parametrize("sign", [1, -1], ids=["longer", "shorter"])
@pytest.mark.parametrize("example", ROWS)
def test_derivatives_that_are_wrong_by_twice_the_stated_bias_are_noticed(example, sign):
    assert check(example, 2 * sign * bias(example)).verdict.startswith("biased")


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
