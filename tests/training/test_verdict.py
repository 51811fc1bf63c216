"""The verdict on synthetic loss curves of which the answer is known."""

import math
import random

import pytest

from torch_radbp.training.recovery.verdict import CONVERGED, FALLING, NOISE, RISING, TOO_SHORT, ImageErrors, judge_losses

UNCHANGED = ImageErrors(0.1, 0.1)


def curve(expected, steps=120, noise=0.0, relative=0.0, seed=0):
    """Losses expected(t), t in [0, 1], with noise of a constant size and noise in proportion."""
    generator = random.Random(seed)
    values = [expected(step / (steps - 1)) for step in range(steps)]
    return [value + noise * generator.gauss(0, 1) + relative * value * generator.gauss(0, 1) for value in values]


CURVES = {
    "falls to zero": (lambda t: math.exp(-20 * t), 0.01, 0.1, CONVERGED),
    "falls to a rest": (lambda t: 0.3 + math.exp(-20 * t), 0.01, 0.02, CONVERGED),
    "falls to zero, much noise": (lambda t: math.exp(-20 * t), 0.1, 0.0, CONVERGED),
    "straight down": (lambda t: 1 - 0.8 * t, 0.02, 0.0, FALLING),
    "slowly down": (lambda t: math.exp(-2 * t), 0.01, 0.05, FALLING),
    "falls late": (lambda t: 1 / (1 + math.exp(20 * (t - 0.8))), 0.02, 0.0, FALLING),
    "noise about zero": (lambda t: 0.0, 1.0, 0.0, NOISE),
    "noise about a level": (lambda t: 5.0, 0.3, 0.0, NOISE),
    "a fall below the noise": (lambda t: 0.1 * math.exp(-20 * t), 1.0, 0.0, NOISE),
    "rises": (lambda t: 1 + t, 0.02, 0.0, RISING),
    "falls, then rises": (lambda t: (1 - 2 * t) ** 2, 0.02, 0.0, RISING),
}


@pytest.mark.parametrize("case", CURVES)
@pytest.mark.parametrize("steps", [60, 300])
def test_curves_are_told_apart(case, steps):
    expected, noise, relative, word = CURVES[case]
    words = [judge_losses(curve(expected, steps, noise, relative, seed), True, UNCHANGED).word for seed in range(100)]
    # A rule at 4 standard errors, which are estimated from as few as 6 steps at the start, errs now and then.
    assert words.count(word) >= 95, {each: words.count(each) for each in set(words)}


def test_the_noise_of_a_step_is_found_under_a_trend():
    verdict = judge_losses(curve(lambda t: 10 - 9 * t, 600, noise=0.2), True, UNCHANGED)
    assert verdict.noise == pytest.approx(0.2, rel=0.15)


@pytest.mark.parametrize(("rest", "expected"), [(0.0, "down to the noise"), (0.05, "stays above zero")])
def test_an_unbiased_loss_is_compared_with_zero(rest, expected):
    losses = curve(lambda t: rest + math.exp(-20 * t), 300, noise=0.02)
    assert expected in judge_losses(losses, True, UNCHANGED).explanation
    assert "zero" not in judge_losses(losses, False, UNCHANGED).explanation


def test_skipped_steps_are_left_out_and_short_curves_are_not_judged():
    assert judge_losses([1.0] * 19, True, UNCHANGED).word == TOO_SHORT
    assert judge_losses([], True, UNCHANGED).word == TOO_SHORT
    losses = curve(lambda t: math.exp(-20 * t), noise=0.01)
    losses[5] = losses[70] = float("nan")
    assert judge_losses(losses, True, UNCHANGED).word == CONVERGED


def test_a_curve_without_any_noise_is_judged():
    assert judge_losses([1.0] * 50, True, UNCHANGED).word == NOISE
    assert judge_losses([1.0] * 10 + [0.0] * 50, True, UNCHANGED).word == CONVERGED
    assert judge_losses([float(50 - step) for step in range(50)], False, UNCHANGED).word == FALLING


def test_a_fall_that_only_the_image_shows_counts():
    losses = curve(lambda t: 0.1 * math.exp(-20 * t), noise=1.0)
    assert judge_losses(losses, True, ImageErrors(0.1, 0.09)).word == NOISE
    verdict = judge_losses(losses, True, ImageErrors(0.1, 0.02))
    assert verdict.word == CONVERGED and "error of the image came down from 0.1 to 0.02" in verdict.explanation
