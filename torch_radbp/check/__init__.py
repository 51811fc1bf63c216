"""Checks of a scene's gradients: finite differences, forward mode and the backward pass compared with each other."""

from torch_radbp.check.gradient import check_gradient
from torch_radbp.check.outcome import GradientCheck

__all__ = ["GradientCheck", "check_gradient"]
