"""The verdict on a run: converged, still falling, rising, or nothing but noise.

The loss of a step is a random number. Its noise sigma is taken from the differences of neighbouring steps,

    sigma^2 = mean((y[i + 1] - y[i])^2) / 2

which a trend hardly touches (von Neumann 1941). The rule, over the steps whose loss is finite:

1. Fewer than 20 steps: "too short".
2. The tail is the last third. A straight line is fitted to it; s is its slope in standard errors, and the change is what it
   falls (or rises) over the tail. If |s| >= 4 and the change is more than 5% of all that the curve has come down (or of its
   level, if it has not come down), it is "still falling" or "rising".
3. Otherwise the tail is flat. The run has "converged" if it has come down to there: the first tenth of the curve lies more
   than 4 standard errors above the tail, or else the image shows it, which is rendered with more samples than a step: its
   RMS difference from the target has come down by a fifth or more. If neither shows anything, there is only "noise".

Whether a flat tail is at the noise floor, where the loss cannot tell better parameters, is said beside it: the two-buffer
loss is 0 there in expectation, so that its mean is compared with its standard error.

Reference: von Neumann et al. 1941, "The mean square successive difference".
"""

import math
from typing import NamedTuple

FEWEST_STEPS = 20
SIGNIFICANT = 4.0  # standard errors
NOTABLE = 0.05  # of what the curve has come down
IMPROVED = 0.8  # of the error of the image before

TOO_SHORT, FALLING, RISING, NOISE, CONVERGED = "too short", "still falling", "rising", "noise", "converged"


class Verdict(NamedTuple):
    """A judgement of a loss curve.

    Attributes:
        word: one of the five above.
        explanation: a sentence with the numbers behind it.
        noise: standard deviation of the loss of a single step, in the tail; None if the curve is too short.
        level: mean of the tail; None likewise.
    """

    word: str
    explanation: str
    noise: float | None = None
    level: float | None = None


class ImageErrors(NamedTuple):
    """RMS differences from the target, of the image before the first step and after the last."""

    before: float
    after: float


def judge_losses(losses: list[float], unbiased: bool, images: ImageErrors) -> Verdict:
    """Applies the rule of the module's docstring.

    Args:
        losses: one for each step; NaN where a step was skipped.
        unbiased: the expected loss of the right parameters is 0, as that of the two-buffer loss.
        images: what the report's images show.
    """
    values = [value for value in losses if math.isfinite(value)]
    if len(values) < FEWEST_STEPS:
        return Verdict(TOO_SHORT, f"{len(values)} steps with a loss are too few to tell; {FEWEST_STEPS} are needed.")
    tail, head = values[-max(len(values) // 3, 10):], values[: max(len(values) // 10, 2)]
    noise, level = _noise(tail), _mean(tail)
    error = noise / math.sqrt(len(tail))
    change, change_error = _trend(tail, noise)
    start = _mean(head)
    start_error = max(_noise(head), noise) / math.sqrt(len(head))
    drop = start - level
    seen = drop > SIGNIFICANT * math.hypot(error, start_error)
    scale = drop if seen else max(abs(level), noise)
    if abs(change) > SIGNIFICANT * change_error and abs(change) > NOTABLE * scale:
        share = f"{abs(change) / scale:.0%} of " + ("what it has come down in all" if seen else "its size")
        way = "falls" if change < 0 else "rises"
        return Verdict(FALLING if change < 0 else RISING,
                       f"Over the last third of the steps the loss {way} by {abs(change):.2g}, {share}.", noise, level)
    if not seen and images.after > IMPROVED * images.before:
        return Verdict(NOISE, f"The loss begins at {start:.2g} and ends at {level:.2g}, no further apart than noise "
                              f"explains ({noise:.2g} for one step), and the image has not come closer to the target: take "
                              "more samples, or parameters that the image shows.", noise, level)
    floor = ""
    if unbiased:
        at_floor = abs(level) <= SIGNIFICANT * error
        floor = (" It is down to the noise: zero within its standard error." if at_floor else
                 " It stays above zero: something that is not recovered differs from the target.")
    came_down = f"The loss came down from {start:.2g} to {level:.2g}" if seen else (
        f"The error of the image came down from {images.before:.2g} to {images.after:.2g} (RMS)")
    return Verdict(CONVERGED, f"{came_down}, and the loss is flat over the last third of the steps, as far as its noise "
                              f"lets see ({noise:.2g} for one step).{floor}", noise, level)


def _mean(values: list[float]) -> float:
    return math.fsum(values) / len(values)


def _noise(values: list[float]) -> float:
    """Standard deviation of single values, from the differences of neighbours."""
    squares = [(after - before) ** 2 for before, after in zip(values, values[1:])]
    return math.sqrt(_mean(squares) / 2)


def _trend(values: list[float], noise: float) -> tuple[float, float]:
    """Change from the first to the last value of a straight line through them, and its standard error."""
    centre, mean = (len(values) - 1) / 2, _mean(values)
    spread = math.fsum((index - centre) ** 2 for index in range(len(values)))
    slope = math.fsum((index - centre) * (value - mean) for index, value in enumerate(values)) / spread
    length = len(values) - 1
    return slope * length, noise / math.sqrt(spread) * length
