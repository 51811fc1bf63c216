"""What each step does: a pure function of recipe and step, so that a resumed run continues exactly."""

from collections.abc import Sequence

import torch

from torch_radbp.training.recipe import Recipe, Stage
from torch_radbp.training.recovery.parameters import matching
from torch_radbp.training.recovery.recovered import RecoveredParameter
from torch_radbp.training.recovery.schedule import learning_rate_factor

WHOLE = Stage(from_step=0)  # what a recipe without stages does


class Plan:
    """The steps of a recipe.

    Args:
        recipe: a checked recipe.
        parameters: that are recovered.
        views: the number of targets.

    Raises:
        ValueError: a stage names a parameter that is not recovered.
    """

    def __init__(self, recipe: Recipe, parameters: Sequence[RecoveredParameter], views: int):
        self.recipe, self.count = recipe, views
        self.stages = [WHOLE, *recipe.stages]
        self.moving_in, self.rates_in = [], []
        for number, stage in enumerate(self.stages):
            place = f"stages[{number - 1}]"
            names = {each.name for pattern in stage.parameters or []
                     for each in matching(parameters, pattern, f"{place}.parameters")}
            self.moving_in.append([each for each in parameters if stage.parameters is None or each.name in names])
            self.rates_in.append({each.name: rate for pattern, rate in stage.learning_rates.items()
                                  for each in matching(parameters, pattern, f"{place}.learning_rates")})

    def number(self, step: int) -> int:
        """The number of a step's stage; 0 before the first, where all is as the recipe says."""
        return sum(stage.from_step <= step for stage in self.recipe.stages)

    def scales(self) -> list[float]:
        """The sizes of images, relative to the targets', that steps have; the largest first."""
        return sorted({stage.scale for stage in self.stages}, reverse=True)

    def spp(self, step: int) -> int:
        """Samples per pixel."""
        return self.stages[self.number(step)].spp or self.recipe.render.spp

    def scale(self, step: int) -> float:
        """The size of the images, relative to the targets'."""
        return self.stages[self.number(step)].scale

    def moving(self, step: int) -> list[RecoveredParameter]:
        """The parameters that a step moves."""
        return self.moving_in[self.number(step)]

    def moves(self, parameter: RecoveredParameter, first: int, end: int) -> int:
        """In how many of the steps from `first` up to `end` a parameter is moved."""
        return sum(any(each is parameter for each in self.moving(step)) for step in range(first, end))

    def learning_rate(self, parameter: RecoveredParameter, step: int) -> float:
        """The learning rate of a parameter."""
        recipe, spec = self.recipe, parameter.spec
        rate = self.rates_in[self.number(step)].get(parameter.name)
        rate = rate or spec.learning_rate or recipe.optimizer_of(spec).learning_rate
        return rate * learning_rate_factor(recipe.schedule_of(spec), step, recipe.steps)

    def views(self, step: int) -> list[int]:
        """The numbers of the targets that a step renders: all, or some of them in turn, each epoch in another order."""
        stage = self.stages[self.number(step)]
        size = stage.views_per_step or self.recipe.views_per_step or self.count
        if size == self.count:
            return list(range(self.count))
        turns = self.count // size  # what is left over of an epoch has its turn in the next
        epoch, turn = divmod(step - stage.from_step, turns)
        generator = torch.Generator().manual_seed((self.recipe.render.seed << 32) + stage.from_step + epoch * turns)
        order = torch.randperm(self.count, generator=generator)
        return sorted(order[turn * size : (turn + 1) * size].tolist())
