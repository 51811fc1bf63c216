"""The verdict on synthetic loss curves of which the answer is known."""

import math
import random

import pytest

from torch_radbp.training.recovery.verdict import (
    CONVERGED,
    FALLING,
    MOVING,
    OUT_OF_SIGNAL,
    RISING,
    TOO_SHORT,
    WORSE,
    ImageErrors,
    ParameterCurve,
    judge_run,
)

UNCHANGED = ImageErrors(0.1, 0.1)


def curve(expected, steps=120, noise=0.0, relative=0.0, seed=0):
    """Losses expected(t), t in [0, 1], with noise of a constant size and noise in proportion."""
    generator = random.Random(seed)
    values = [expected(step / (steps - 1)) for step in range(steps)]
    return [value + noise * generator.gauss(0, 1) + relative * value * generator.gauss(0, 1) for value in values]


def to_a_slope(t, share):
    """A fall from 1 to 0.01, of which the last third still loses a share."""
    return 0.01 * (1 - share * 3 * (t - 5 / 6)) + math.exp(-30 * t)


CURVES = {
    "falls to zero": (lambda t: math.exp(-20 * t), 0.01, 0.1, CONVERGED),
    "falls to a rest": (lambda t: 0.3 + math.exp(-20 * t), 0.01, 0.02, CONVERGED),
    "falls to zero, much noise": (lambda t: math.exp(-20 * t), 0.1, 0.0, CONVERGED),
    "straight down": (lambda t: 1 - 0.8 * t, 0.02, 0.0, FALLING),
    "slowly down": (lambda t: math.exp(-2 * t), 0.01, 0.05, FALLING),
    "the tail by 43% of its level": (lambda t: to_a_slope(t, 0.43), 0.0004, 0.0, FALLING),
    "the tail by 5% of its level": (lambda t: to_a_slope(t, 0.05), 0.0004, 0.0, CONVERGED),
    "without end, to a millionth": (lambda t: math.exp(-16 * t), 0.0, 0.0, CONVERGED),
    "falls late": (lambda t: 1 / (1 + math.exp(20 * (t - 0.8))), 0.02, 0.0, FALLING),
    "noise about zero": (lambda t: 0.0, 1.0, 0.0, OUT_OF_SIGNAL),
    "noise about a level": (lambda t: 5.0, 0.3, 0.0, OUT_OF_SIGNAL),
    "a fall below the noise": (lambda t: 0.1 * math.exp(-20 * t), 1.0, 0.0, OUT_OF_SIGNAL),
    "rises": (lambda t: 1 + t, 0.02, 0.0, RISING),
    "falls, then rises": (lambda t: (1 - 2 * t) ** 2, 0.02, 0.0, RISING),
}


@pytest.mark.parametrize("case", CURVES)
@pytest.mark.parametrize("steps", [60, 300])
def test_curves_are_told_apart(case, steps):
    expected, noise, relative, word = CURVES[case]
    words = [judge_run(curve(expected, steps, noise, relative, seed), True, UNCHANGED).word for seed in range(100)]
    # A rule at 3 standard errors, which are estimated from as few as 20 steps, errs now and then.
    assert words.count(word) >= 95, {each: words.count(each) for each in set(words)}


def test_the_noise_of_a_step_is_found_under_a_trend():
    verdict = judge_run(curve(lambda t: 10 - 9 * t, 600, noise=0.2), True, UNCHANGED)
    assert verdict.noise == pytest.approx(0.2, rel=0.15)


@pytest.mark.parametrize(("rest", "expected"), [(0.0, "down to the noise"), (0.05, "stays above zero")])
def test_an_unbiased_loss_is_compared_with_zero(rest, expected):
    losses = curve(lambda t: rest + math.exp(-20 * t), 300, noise=0.02)
    assert expected in judge_run(losses, True, UNCHANGED).explanation
    assert "zero" not in judge_run(losses, False, UNCHANGED).explanation


def test_skipped_steps_are_left_out_and_short_curves_are_not_judged():
    assert judge_run([1.0] * 19, True, UNCHANGED).word == TOO_SHORT
    assert judge_run([], True, UNCHANGED).word == TOO_SHORT
    losses = curve(lambda t: math.exp(-20 * t), noise=0.01)
    losses[5] = losses[70] = float("nan")
    assert judge_run(losses, True, UNCHANGED).word == CONVERGED


def test_a_curve_without_any_noise_is_judged():
    assert judge_run([1.0] * 50, True, UNCHANGED).word == OUT_OF_SIGNAL
    assert judge_run([1.0] * 10 + [0.0] * 50, True, UNCHANGED).word == CONVERGED
    assert judge_run([float(50 - step) for step in range(50)], False, UNCHANGED).word == FALLING


def test_a_fall_that_only_the_image_shows_counts():
    losses = curve(lambda t: 0.1 * math.exp(-20 * t), noise=1.0)
    assert judge_run(losses, True, ImageErrors(0.1, 0.09)).word == OUT_OF_SIGNAL
    verdict = judge_run(losses, True, ImageErrors(0.1, 0.02))
    assert verdict.word == CONVERGED and "error of the image came down from 0.1 to 0.02" in verdict.explanation


FELL = curve(lambda t: math.exp(-20 * t), 120, noise=0.01)
CLOSER = ImageErrors(0.1, 0.01)


def parameter(expected, noise=0.0, truth=None, seed=1):
    """A parameter of one entry, expected(t) with noise of a constant size, and its distance from the truth."""
    values = [expected(0.0), *curve(expected, 120, noise, seed=seed)]
    distances = None if truth is None else [abs(value - truth) for value in values]
    return ParameterCurve("wall", [values], distances, truth or 0.0)


# Name -> (what a parameter does, its noise, its truth or None, the verdict).
PARAMETERS = {
    "to the truth": (lambda t: 0.2 + 0.3 * math.exp(-10 * t), 0.002, 0.2, CONVERGED),
    "to a rest": (lambda t: 0.2 + 0.3 * math.exp(-10 * t), 0.002, None, CONVERGED),
    "at the truth from the start": (lambda t: 0.5, 0.002, 0.5, CONVERGED),
    "away from the truth": (lambda t: 0.5 - 0.3 * (1 - math.exp(-10 * t)), 0.002, 0.6, WORSE),
    "beyond the truth": (lambda t: 0.5 - 0.3 * (1 - math.exp(-10 * t)), 0.002, 0.4, WORSE),
    "straight on": (lambda t: 0.5 - 0.3 * t, 0.002, None, MOVING),
    "straight to the truth": (lambda t: 0.5 - 0.3 * t, 0.002, 0.2, MOVING),
    "almost to a rest": (lambda t: 0.2 + 0.3 * math.exp(-3 * t), 0.002, None, CONVERGED),
    "closer and closer": (lambda t: 0.2 + 0.3 * (0.9 * math.exp(-10 * t) + 0.1 * (1 - t)), 0.0002, 0.2, MOVING),
    "never from its place": (lambda t: 0.5, 0.01, None, OUT_OF_SIGNAL),
    "a third of the way": (lambda t: 0.5 - 0.1 * (1 - math.exp(-10 * t)), 0.002, 0.2, OUT_OF_SIGNAL),
    "two thirds of the way": (lambda t: 0.5 - 0.2 * (1 - math.exp(-10 * t)), 0.002, 0.2, CONVERGED),
}


@pytest.mark.parametrize("case", PARAMETERS)
def test_each_parameter_is_looked_at(case):
    expected, noise, truth, word = PARAMETERS[case]
    good = parameter(lambda t: 0.2 + 0.3 * math.exp(-10 * t), 0.002, 0.2)._replace(name="floor")
    tried = [parameter(expected, noise, truth, seed) for seed in range(50)]
    verdicts = [judge_run(FELL, True, CLOSER, [good, each]) for each in tried]
    words = [verdict.word for verdict in verdicts]
    assert words.count(word) >= 48, {each: words.count(each) for each in set(words)}
    named = [verdict.explanation for verdict in verdicts if verdict.word == word != CONVERGED]
    assert all("wall" in each and "floor" not in each for each in named)


def test_the_distances_are_told_of_a_parameter_that_got_worse():
    verdict = judge_run(FELL, True, CLOSER, [parameter(lambda t: 0.5 - 0.3 * (1 - math.exp(-10 * t)), truth=0.6)])
    assert "wall (off by 0.1 before, 0.4 now)" in verdict.explanation


SLOWED = [0.02 ** (step / 119) for step in range(120)]  # the exponential schedule of recipes


@pytest.mark.parametrize(("rest", "rates", "word"), [
    (0.3, SLOWED, MOVING), (0.3, [], CONVERGED), (0.3, [1.0] * 120, CONVERGED), (0.0, SLOWED, CONVERGED)])
def test_a_parameter_that_the_schedule_has_stopped_on_its_way_is_moving(rest, rates, word):
    """It moves at a constant pace for its learning rate, in the tail by 5% of its way; unless the loss tells no better."""
    gone = [sum(SLOWED[:step]) / sum(SLOWED) for step in range(121)]
    losses = curve(lambda t: rest + math.exp(-20 * t), 120, noise=0.01)
    verdict = judge_run(losses, True, CLOSER, [ParameterCurve("lamp", [[0.3 * part for part in gone]])], rates)
    assert verdict.word == word and ("later" in verdict.explanation) == (word == MOVING)


def test_a_biased_loss_has_no_floor_to_run_out_at():
    assert judge_run(FELL, False, CLOSER, [parameter(lambda t: 0.5, 0.01)]).word == CONVERGED


def test_the_change_of_the_tail_is_told_against_its_level():
    losses = curve(lambda t: to_a_slope(t, 0.43), 300)
    assert "the loss falls: a change of -43% of its level" in judge_run(losses, True, CLOSER).explanation


def test_a_run_that_learned_nothing_is_not_blamed_on_a_parameter():
    losses = curve(lambda t: 1.0, noise=0.1)
    assert judge_run(losses, True, UNCHANGED, [parameter(lambda t: 0.5 - 0.3 * t, truth=0.9)]).word == OUT_OF_SIGNAL


@pytest.mark.parametrize("steps", [60, 120, 300])
def test_a_fall_by_43_percent_of_the_level_is_seen_at_4_standard_errors_and_a_half(steps):
    error = 0.43 * 0.01 / 4.5
    noise = error * math.sqrt(steps // 3 / 12)
    curves = [curve(lambda t: to_a_slope(t, 0.43), steps, noise, seed=seed) for seed in range(100)]
    words = [judge_run(losses, True, CLOSER).word for losses in curves]
    assert words.count(FALLING) >= 85 and {*words} <= {FALLING, CONVERGED}
