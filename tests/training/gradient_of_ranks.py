"""A program for torchrun: the gradient of one step in float64, written by the first process. Arguments: recipe, result.

In plain torch: for one step, to load what is compiled takes each process longer.
"""

import sys
from pathlib import Path

import torch

import torch_radbp as rb
from torch_radbp.training.ranks import Ranks, joined
from torch_radbp.training.recipe_file import read_recipe
from torch_radbp.training.recovery import optimize, problem


def gradient(recipe: Path, ranks: Ranks) -> list[torch.Tensor]:
    """The gradients of the first step, those of all processes put together, and the loss."""
    load = rb.load
    problem.rb.load = lambda *arguments, **named: load(*arguments, **named).double()
    try:
        recovery = problem.Recovery(read_recipe(recipe, ["render.compile=false"]), ranks)
    finally:
        problem.rb.load = load
    levels = recovery.levels.levels
    levels[1.0] = levels[1.0]._replace(images=levels[1.0].images.double())
    loss, terms, _, trouble = optimize.take_gradient(recovery, 0)
    loss, _, trouble, _ = optimize.together(recovery, 0, loss, terms, trouble, False)
    assert trouble is None
    return [*(each.raw.grad for each in recovery.parameters), loss.detach().double()]


if __name__ == "__main__":
    torch.set_num_threads(1)
    with joined() as ranks:
        found = gradient(Path(sys.argv[1]), ranks)
        if ranks.is_first:
            torch.save(found, sys.argv[2])
