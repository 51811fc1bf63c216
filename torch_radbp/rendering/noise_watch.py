"""Detects loops that render every step with the same noise."""

from __future__ import annotations

import warnings
from collections.abc import Mapping

import torch
from torch import Tensor

from torch_radbp.plugin.errors import level_of_the_caller


class RepeatedNoiseWarning(UserWarning):
    """Warning: all steps of an optimisation are rendered with one seed, so that it fits their noise."""


class NoiseWatch:
    """Warns once if a renderer is called without a seed again after its parameters have changed."""

    def __init__(self):
        self.versions: dict[str, int] = {}

    def look(self, seed: int | None, parameters: Mapping[str, Tensor]) -> None:
        """Observes a call: its seed, and the parameters that require a gradient."""
        if seed is not None or not parameters or not torch.is_grad_enabled():
            return
        versions = {name: parameter._version for name, parameter in parameters.items()}
        if any(self.versions.get(name, version) != version for name, version in versions.items()):
            warnings.warn("the renderer was called without a seed again after its parameters had changed: each step of such "
                          "a loop has the same noise, which its result is then fitted to; give each its own, as in "
                          "renderer(seed=step)", RepeatedNoiseWarning, stacklevel=level_of_the_caller())
        self.versions = versions
