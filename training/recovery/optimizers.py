"""The optimisers of a run: one for each leaf, so that parameters may have steps, schedules and rests of their own."""

import copy

import torch
from torch import Tensor

from torch_radbp.optim import AdamUniform
from torch_radbp.training import recipe as schema
from torch_radbp.training.recovery.recovered import RecoveredParameter

CLASSES = {"adam": torch.optim.Adam, "sgd": torch.optim.SGD, "rmsprop": torch.optim.RMSprop, "adam_uniform": AdamUniform}


def make_optimizers(parameters: list[RecoveredParameter], recipe: schema.Recipe) -> dict[str, torch.optim.Optimizer]:
    """Returns the torch optimisers of a recipe's parameters, by the names of their leaves."""
    return {name: make_optimizer(leaf, recipe.optimizer_of(each.spec)) for each in parameters
            for name, leaf in each.leaves.items()}


def make_optimizer(leaf: Tensor, spec: schema.AnyOptimizer) -> torch.optim.Optimizer:
    """Returns the torch optimiser of one leaf."""
    options = spec.model_dump(exclude={"name", "learning_rate"})
    return CLASSES[spec.name]([leaf], lr=spec.learning_rate, **options)


def moments_of(optimizer: torch.optim.Optimizer) -> dict[str, Tensor]:
    """What an optimiser keeps of its leaf, by name; nothing before its first step."""
    return {name: value for held in optimizer.state.values() for name, value in held.items() if value is not None}


def put_moments(optimizer: torch.optim.Optimizer, moments: dict[str, Tensor]) -> None:
    """Gives an optimiser what another one has kept of such a leaf."""
    optimizer.load_state_dict(optimizer.state_dict() | {"state": {0: moments} if moments else {}})


def expected_moments(optimizer: torch.optim.Optimizer, leaf: Tensor) -> dict[str, Tensor]:
    """What an optimiser keeps of a leaf like this from its first step on, on the device `meta`: shapes and dtypes."""
    like = torch.zeros_like(leaf, device="meta")
    group, = optimizer.param_groups
    twin = type(optimizer)([{**copy.copy(group), "params": [like]}])
    like.grad = torch.zeros_like(like)
    twin.step()
    return {name: value for name, value in moments_of(twin).items() if isinstance(value, Tensor)}
