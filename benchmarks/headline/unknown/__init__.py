"""What can be unknown in a task, a file for each kind: how either renderer optimises it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, Protocol

import numpy as np

import torch_radbp as rb


class Variable(ABC):
    """An unknown in the scene of one of the renderers, with its first guess, and an optimiser of its own."""

    optimizer: Any

    def apply(self) -> None:  # noqa: B027 (a parametrisation of torch needs no such step)
        """Before each rendering: makes the parameter of the scene of what is optimised, attached."""

    def clamp(self) -> None:  # noqa: B027 (not all unknowns have bounds)
        """After each step: back into the domain."""

    @abstractmethod
    def found(self) -> np.ndarray:
        """What has been found so far, the same numbers for both renderers."""


class Unknown(Protocol):
    """Something to recover."""

    @property
    def name(self) -> str: ...

    def ours(self, scene: rb.Scene) -> Variable: ...

    def mitsubas(self, mi, parameters) -> Variable:
        """`parameters`: as `mi.traverse` returns them."""
