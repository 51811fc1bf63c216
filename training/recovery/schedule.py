"""Learning-rate schedules as pure functions of the step, so that a resumed run continues exactly."""

import math

from torch_radbp.training import recipe_optimizer as recipe


def learning_rate_factor(schedule: recipe.AnySchedule, step: int, steps: int) -> float:
    """Returns what the learning rates are multiplied with at `step` of `steps`."""
    progress = step / max(steps - 1, 1)
    match schedule:
        case recipe.Cosine():
            return schedule.final + (1 - schedule.final) * 0.5 * (1 + math.cos(math.pi * progress))
        case recipe.Step():
            return schedule.factor ** (step // schedule.every)
        case recipe.Exponential():
            return schedule.final**progress
        case recipe.Constant():
            return 1.0
    raise TypeError(f"no schedule for {schedule!r}")
