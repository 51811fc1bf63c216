"""Learning-rate schedules as pure functions of the step, so that a resumed run continues exactly."""

import math

from torch.optim import Optimizer
from torch.optim.lr_scheduler import LambdaLR

from torch_radbp.training import recipe


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


def make_scheduler(optimizer: Optimizer, schedule: recipe.AnySchedule, steps: int, step: int = 0) -> LambdaLR:
    """Returns a torch scheduler, at a step, that multiplies every group's own learning rate."""
    for group in optimizer.param_groups:
        group.setdefault("initial_lr", group["lr"])
    return LambdaLR(optimizer, lambda at: learning_rate_factor(schedule, min(at, steps - 1), steps), last_epoch=step - 1)
