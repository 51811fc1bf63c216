"""The verdict on a run: converged, still falling, rising, still moving, a parameter worse, or out of signal.

The loss of a step is a random number. Its noise sigma is taken from the differences of neighbouring steps,

    sigma^2 = mean((y[i + 1] - y[i])^2) / 2

which a trend hardly touches (von Neumann 1941). The rule, over the steps whose loss is finite:

1. Fewer than 20 steps: "too short".
2. The tail is the last third, its level its mean. A straight line is fitted to it; the change is what it falls (or rises)
   over the tail. If that is at least 3 standard errors and a tenth of the tail's own level, it is "still falling" or
   "rising"; unless it is less than a ten-thousandth of all that the curve has come down, a hundredth of it in parameters.
   Of flat tails of 20 steps it calls 2% a trend by mistake, of those of 100 steps 0.3%.
3. Otherwise the tail is flat as far as its noise lets see. The run has come down to there if the first tenth of the curve
   lies more than 4 standard errors above the tail, or else if the image shows it, which is rendered with more samples than a
   step: its RMS difference from the target has come down by a fifth or more. If neither shows anything, it "ran out of
   signal".
4. Of a run that has come down each parameter is looked at, over the same tail:
   "parameter worse": its distance from the truth, where that is known, has grown by a tenth or more, and beyond its own
   fluctuation.
   "still moving": from the first half of the tail to the second it moves by more than twice its standard deviation within
   these halves, which a straight line does by 3.5, and over the tail by more than a tenth of its whole way; or its distance
   from the truth comes down so, by more than a tenth of its own level. Where the schedule has lowered the learning rate and
   the loss is not 0 within its standard error, the tenth is less, in proportion to what is left of the rate in the tail, at
   least 0.03: steps that are short because the schedule makes them so are no sign that a parameter has arrived.
   "ran out of signal": the loss is 0 within its standard error, as the two-buffer loss is in expectation where the image is
   right, and the parameter has come less than half of its way to the truth; if that is not known, its whole way is within
   its own fluctuation.
5. Otherwise the run has "converged".

Reference: von Neumann et al. 1941, "The mean square successive difference".
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

FEWEST_STEPS = 20
SIGNIFICANT = 4.0  # standard errors
TREND = 3.0  # likewise, of the slope of the tail
NOTABLE = 0.1  # of the level of the tail, the way of a parameter, its distance from the truth
LEAST_PACE = 0.3  # of the learning rate in the tail, by which `NOTABLE` is scaled at most
NEGLIGIBLE = 1e-4  # of what the curve has come down
IMPROVED = 0.8  # of the error of the image before
RESOLVED = 0.5  # of the distance from the truth before
STEADY = 2.0  # standard deviations within the halves of a tail
VISIBLE = 0.01  # of the size of a parameter

TOO_SHORT, FALLING, RISING, CONVERGED = "too short", "still falling", "rising", "converged"
MOVING, WORSE, OUT_OF_SIGNAL = "still moving", "parameter worse", "ran out of signal"


class Verdict(NamedTuple):
    """A judgement of a run.

    Attributes:
        word: one of the seven above.
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


class ParameterCurve(NamedTuple):
    """What a parameter did.

    Attributes:
        name: of the parameter.
        columns: its entries, their mean if they are many, or its motion; each before the first step, then after every one.
        distances: RMS differences from the truth at the same times; None if it is not known.
        size: RMS of the truth, or 0.
    """

    name: str
    columns: list[list[float]]
    distances: list[float] | None = None
    size: float = 0.0


class Fall(NamedTuple):
    """A loss curve: where it starts, and the straight line through its tail, each with its standard error."""

    start: float
    start_error: float
    level: float
    level_error: float
    change: float
    change_error: float
    noise: float

    @property
    def is_seen(self) -> bool:
        """True if the tail is below the start."""
        return self.start - self.level > SIGNIFICANT * math.hypot(self.level_error, self.start_error)

    @property
    def is_over(self) -> bool:
        """True if the tail is flat."""
        scale = max(abs(self.level), self.level_error)
        slight = self.is_seen and abs(self.change) <= NEGLIGIBLE * (self.start - self.level)
        return abs(self.change) <= max(TREND * self.change_error, NOTABLE * scale) or slight

    @property
    def is_at_zero(self) -> bool:
        """True if the tail is 0 within its standard error."""
        return abs(self.level) <= SIGNIFICANT * self.level_error

    @property
    def tail(self) -> str:
        """The change over the tail in words."""
        if self.is_at_zero:
            return f"a change of {self.change:+.2g}, with a standard error of {self.change_error:.2g}"
        share, error = self.change / abs(self.level), self.change_error / abs(self.level)
        return f"a change of {share:+.0%} of its level, with a standard error of {error:.0%}"


def judge_run(
    losses: list[float],
    unbiased: bool,
    images: ImageErrors,
    parameters: Sequence[ParameterCurve] = (),
    rates: Sequence[float] = (),
) -> Verdict:
    """Applies the rule of the module's docstring.

    Args:
        losses: one for each step; NaN where a step was skipped.
        unbiased: the expected loss of the right parameters is 0, as that of the two-buffer loss.
        images: what the report's images show.
        parameters: what the parameters did.
        rates: the learning rate of each step, relative to any other; none: it was the same throughout.
    """
    values = [value for value in losses if math.isfinite(value)]
    if len(values) < FEWEST_STEPS:
        return Verdict(TOO_SHORT, f"{len(values)} steps with a loss are too few to tell; {FEWEST_STEPS} are needed.")
    fall = _fall(values)
    word, explanation = _judge_fall(fall, unbiased, images, parameters, _pace(rates))
    return Verdict(word, explanation, fall.noise, fall.level)


def _judge_fall(
    fall: Fall, unbiased: bool, images: ImageErrors, parameters: Sequence[ParameterCurve], pace: float
) -> tuple[str, str]:
    if not fall.is_over:
        way = "falls" if fall.change < 0 else "rises"
        return (FALLING if fall.change < 0 else RISING,
                f"Over the last third of the steps the loss {way}: {fall.tail}.")
    if not fall.is_seen and images.after > IMPROVED * images.before:
        return OUT_OF_SIGNAL, (f"The loss begins at {fall.start:.2g} and ends at {fall.level:.2g}, no further apart than "
                               f"noise explains ({fall.noise:.2g} for one step), and the image has not come closer to the "
                               "target: take more samples, or parameters that the image shows.")
    found = _judge_parameters(parameters, unbiased and fall.is_at_zero, pace)
    if found is not None:
        return found
    came_down = f"The loss came down from {fall.start:.2g} to {fall.level:.2g}" if fall.is_seen else (
        f"The error of the image came down from {images.before:.2g} to {images.after:.2g} (RMS)")
    return CONVERGED, (f"{came_down}, and the loss is flat over the last third of the steps, as far as its noise lets see "
                       f"({fall.noise:.2g} for one step): {fall.tail}.{_floor(fall, unbiased)}")


def _floor(fall: Fall, unbiased: bool) -> str:
    """Whether the loss could tell better parameters."""
    if not unbiased:
        return ""
    if fall.is_at_zero:
        return " It is down to the noise: zero within its standard error."
    return " It stays above zero: something that is not recovered differs from the target."


def _judge_parameters(parameters: Sequence[ParameterCurve], at_zero: bool, pace: float) -> tuple[str, str] | None:
    """The verdict on the parameters of a run that has come down; None if nothing is wrong with them.

    Args:
        parameters: what they did.
        at_zero: the loss is 0 within its standard error, as it is where they are right.
        pace: from `_pace`.
    """
    worse = [each for each in parameters if _is_worse(each)]
    if worse:
        return WORSE, (f"The loss came down, but further from the truth than before the first step: {_distances(worse)}. "
                       "Something else explains the target as well: take more views, bounds, or fewer parameters.")
    moving = [each.name for each in parameters if _is_moving(each, 1.0 if at_zero else pace)]
    if moving:
        instead = "a schedule that lowers the learning rate" + (" later" if pace < 1.0 else "")
        return MOVING, ("The loss falls by little or nothing over the last third of the steps, but still moving: "
                        f"{', '.join(moving)}. Take more steps, or {instead}.")
    lost = [each for each in parameters if at_zero and _is_lost(each)]
    if lost:
        return OUT_OF_SIGNAL, ("The loss is zero within its standard error and tells no better parameters, but not "
                               f"recovered: {_distances(lost)}. Take more samples, or views that show it.")
    return None


def _distances(parameters: list[ParameterCurve]) -> str:
    return ", ".join(each.name if each.distances is None else
                     f"{each.name} (off by {each.distances[0]:.2g} before, {_mean(_end(each.distances)):.2g} now)"
                     for each in parameters)


def _is_worse(parameter: ParameterCurve) -> bool:
    """True if the distance from the truth has grown."""
    if parameter.distances is None:
        return False
    before, after = parameter.distances[0], _mean(_end(parameter.distances))
    growth = after - before
    return growth > max(NOTABLE * before, STEADY * _deviation(_end(parameter.distances)), VISIBLE * parameter.size)


def _pace(rates: Sequence[float]) -> float:
    """The mean learning rate of the tail as a share of that of the whole run, from `LEAST_PACE` to 1."""
    if not any(rates):
        return 1.0
    share = _mean(list(rates)[-_tail_length(len(rates)) :]) / _mean(list(rates))
    return min(max(share, LEAST_PACE), 1.0)


def _is_moving(parameter: ParameterCurve, pace: float) -> bool:
    """True if an entry moves steadily, and notably against the parameter's whole way, or so comes closer to the truth."""
    notable = NOTABLE * pace
    way = max((abs(_mean(_end(column)) - column[0]) for column in parameter.columns), default=0.0)
    if any(abs(_steady_change(column)) > notable * way for column in parameter.columns):
        return True
    if parameter.distances is None:
        return False
    return -_steady_change(parameter.distances) > max(notable * _mean(_end(parameter.distances)), VISIBLE * parameter.size)


def _steady_change(values: list[float]) -> float:
    """Change over the tail by the means of its halves; 0 if fluctuations within these explain it."""
    tail = values[-_tail_length(len(values)) :]
    early, late = tail[: len(tail) // 2], tail[len(tail) // 2 :]
    step = _mean(late) - _mean(early)
    return 2.0 * step if abs(step) > STEADY * max(_deviation(early), _deviation(late)) else 0.0


def _is_lost(parameter: ParameterCurve) -> bool:
    """True if the parameter has not come closer to the truth by half, or, if that is not known, has not left its start."""
    if parameter.distances is not None:
        return _mean(_end(parameter.distances)) > max(RESOLVED * parameter.distances[0], VISIBLE * parameter.size)
    return all(abs(_mean(_end(column)) - column[0]) <= STEADY * _deviation(_end(column)) for column in parameter.columns)


def _fall(values: list[float]) -> Fall:
    tail, head = values[-_tail_length(len(values)):], values[: max(len(values) // 10, 2)]
    noise = _noise(tail)
    change, change_error = _trend(tail, noise)
    return Fall(_mean(head), max(_noise(head), noise) / math.sqrt(len(head)), _mean(tail), noise / math.sqrt(len(tail)),
                change, change_error, noise)


def _tail_length(steps: int) -> int:
    return max(steps // 3, 10)


def _end(values: list[float]) -> list[float]:
    """The second half of the tail."""
    return values[-max(_tail_length(len(values)) // 2, 1) :]


def _mean(values: list[float]) -> float:
    return math.fsum(values) / len(values)


def _deviation(values: list[float]) -> float:
    """Standard deviation."""
    mean = _mean(values)
    return math.sqrt(_mean([(value - mean) ** 2 for value in values]))


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
