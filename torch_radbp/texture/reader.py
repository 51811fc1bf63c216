"""The interface between textures and the tracer: how lanes read a value."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor

from torch_radbp.plugin import Texture
from torch_radbp.vec import Vec2, Vec3


@dataclass(frozen=True)
class Reader(ABC):
    """Reads the textures of one kind, which lie together in a `bank`: a record of tensors, or None."""

    needs_uv: ClassVar[bool] = True  # `read` takes surface coordinates

    @abstractmethod
    def bank(self, textures: Sequence[Texture], dtype: torch.dtype, device: torch.device) -> Any:
        """The tables of some textures, attached to their parameters."""

    @abstractmethod
    def read(self, bank: Any, row: Tensor, uv: Vec2 | None) -> Vec3:
        """Linear RGB at surface coordinates, attached.

        Args:
            bank: attached or tapped.
            row: (N,) int32, which of the textures each lane reads.
            uv: (N,) surface coordinates; None unless `needs_uv`.
        """
