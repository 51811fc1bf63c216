"""Checking gradients of a scene: finite differences, forward mode and the backward pass against each other."""

from torch_radbp.check.gradient import check_gradient
from torch_radbp.check.outcome import GradientCheck

__all__ = ["GradientCheck", "check_gradient"]
