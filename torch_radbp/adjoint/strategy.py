"""What a strategy of the backward pass is. A new one is a file with a class derived from `AdjointStrategy`."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar

from torch import Tensor

from torch_radbp.adjoint.forward_mode import render_tangents
from torch_radbp.adjoint.function import render_with_derivative
from torch_radbp.adjoint.sweep import Sweep
from torch_radbp.call.render_call import RenderCall


class AdjointStrategy(ABC):
    """How a rendering is differentiated: what the forward pass keeps of its paths, and how the backward pass uses it."""

    taped: ClassVar[bool] = False  # autograd records all operations, which run eagerly, and keeps their results
    keep_radiance: ClassVar[bool] = False  # the forward pass keeps L_1 of each path
    keep_hits = True  # and what each ray met

    @property
    def records_all(self) -> bool:
        """True if the backward pass takes no bounce again."""
        return False

    def image(self, call: RenderCall) -> Tensor:
        """The images of a call, (B, 3 + C, H, W) with its C quantities, attached to scene and cameras for backward."""
        return render_with_derivative(call)

    def dual_image(self, call: RenderCall) -> Tensor:
        """The images of a call by its own samples, with the tangents of forward mode."""
        return render_tangents(call)

    @abstractmethod
    def kept(self, bounces: int, most: int) -> tuple[int, ...]:
        """Depths whose state the forward pass keeps after `bounces` bounces of `most` that there may be."""

    @abstractmethod
    def replayed(self, reaching: Sequence[float], kept: tuple[int, ...], moving: bool) -> float:
        """States of a camera path that `backward` holds at once beside those kept.

        Args:
            reaching: for each bounce, the share of the camera paths that reach it.
            kept: depths whose states the forward pass has kept.
            moving: whether rays carry derivatives.
        """

    @abstractmethod
    def backward(self, sweep: Sweep) -> None:
        """Calls `sweep.adjoint` for each bounce of a chunk's paths, the last one first."""
