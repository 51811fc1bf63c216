"""Clamping of parameters to their ranges after each step of an optimizer."""

from __future__ import annotations

from typing import TypeVar

import torch

from torch_radbp.scene.modules.bounds import bring_inside, held_by
from torch_radbp.scene.modules.scene import Scene

AnyOptimizer = TypeVar("AnyOptimizer", bound=torch.optim.Optimizer)


def bounded(optimizer: AnyOptimizer, scene: Scene) -> AnyOptimizer:
    """Makes an optimizer clamp the parameters of a scene to their ranges after each of its steps.

        optimizer = rb.optim.bounded(torch.optim.Adam([green], lr=0.05), scene)

    As `scene.clamp_()` after each step, of what the optimizer holds at that time, whatever else the scene has. Values at an
    end of their range keep the optimizer's momentum beyond it, and come back when gradients have used that up; `Sigmoid` and
    `Log` have no ends to be stopped at, but small steps near them. Within a step nothing is clamped: with
    `torch.optim.LBFGS`, which renders several times in one, use these parametrisations.

    Args:
        optimizer: of any class of torch's or derived from them.
        scene: that is rendered.

    Returns:
        The same optimizer.

    Raises:
        ValueError: if it holds no parameter of the scene.
    """
    if not held_by(scene, optimizer):
        raise ValueError("the optimizer holds no parameter of this scene, so that nothing would be kept in its range: give "
                         "it some, such as scene.get_parameter(\"green.reflectance.value\")")

    def after_step(*_) -> None:
        with torch.no_grad():
            for name, held in held_by(scene, optimizer).items():
                bring_inside(name, held)

    optimizer.register_step_post_hook(after_step)
    return optimizer
