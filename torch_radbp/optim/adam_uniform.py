"""Adam with one step size for all entries of a parameter."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import overload

import torch
from torch import Tensor


class AdamUniform(torch.optim.Optimizer):
    """Adam whose steps are divided by the largest second moment of a parameter, the same for all of its entries.

    So a step is in proportion to the (mean) gradient, which is smooth after `LargeSteps`; dividing entry by entry, as Adam
    does, would bring the noise back.

    Args:
        params: as for any optimiser.
        lr: about how far the entry with the largest gradient moves in a step.
        betas: decay of the first and second moment. The first gradients, of a shape that is far off, are the largest,
            and keep steps small for about 1 / (1 - betas[1]) of them: 0.95 forgets sooner, and leaves more noise.
        eps: is added to the square root of the second.

    Raises:
        ValueError: if one of them is out of range.

    Reference: Nicolet, Jacobson and Jakob 2021, "Large Steps in Inverse Rendering of Geometry", section 4.3.
    """

    def __init__(self, params: Iterable, lr: float = 0.01, betas: tuple[float, float] = (0.9, 0.999), eps: float = 1e-12):
        if not lr > 0:
            raise ValueError(f"lr must be positive, got {lr}")
        if not all(0 <= beta < 1 for beta in betas):
            raise ValueError(f"betas must be at least 0 and below 1, got {betas}")
        if not eps > 0:
            raise ValueError(f"eps must be positive, got {eps}")
        super().__init__(params, {"lr": lr, "betas": betas, "eps": eps})

    @overload
    def step(self, closure: None = None) -> None: ...

    @overload
    def step(self, closure: Callable[[], float]) -> float: ...

    @torch.no_grad()
    def step(self, closure: Callable[[], float] | None = None) -> float | None:
        """Makes one step; `closure`, if given, renders and computes gradients, and its loss is returned."""
        loss = None
        if closure is not None:
            with torch.enable_grad():
                loss = closure()
        for group in self.param_groups:
            for parameter in group["params"]:
                if parameter.grad is not None:
                    self.move(parameter, group)
        return loss

    def move(self, parameter: Tensor, group: dict) -> None:
        """Moves one parameter by its gradient."""
        state, (first, second) = self.state[parameter], group["betas"]
        if not state:
            state["step"] = torch.tensor(0.0, dtype=torch.float64)  # a tensor, as of torch's own optimizers
            state["exp_avg"], state["exp_avg_sq"] = torch.zeros_like(parameter), torch.zeros_like(parameter)
        state["step"] += 1
        mean, square = state["exp_avg"], state["exp_avg_sq"]
        mean.lerp_(parameter.grad, 1 - first)
        square.mul_(second).addcmul_(parameter.grad, parameter.grad, value=1 - second)
        size = (square.max() / (1 - second ** state["step"])).sqrt() + group["eps"]
        parameter.sub_(mean / size * (group["lr"] / (1 - first ** state["step"])))
