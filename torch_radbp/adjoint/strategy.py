"""The interface of strategies of the backward pass. A new one is a file with a class derived from `AdjointStrategy`."""

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

    taped: ClassVar[bool] = False  # autograd records all operations, which run eagerly
    keep_radiance: ClassVar[bool] = False  # the forward pass keeps L_1 of each path
    keep_hits = True  # the forward pass keeps the hit of each ray

    @property
    def records_all(self) -> bool:
        """True if the backward pass replays no bounce."""
        return False

    def image(self, call: RenderCall) -> Tensor:
        """Renders (B, 3 + C, H, W) images with C AOV channels, attached to scene and cameras."""
        return render_with_derivative(call)

    def dual_image(self, call: RenderCall) -> Tensor:
        """Renders images with forward-mode tangents (dual tensors), from the call's own samples."""
        return render_tangents(call)

    @abstractmethod
    def kept(self, bounces: int, most: int) -> tuple[int, ...]:
        """The depths whose path states the forward pass keeps after `bounces` of at most `most` bounces."""

    @abstractmethod
    def replayed(self, reaching: Sequence[float], kept: tuple[int, ...], moving: bool) -> float:
        """The number of path states per camera path that `backward` holds at once beside those kept.

        Args:
            reaching: for each bounce, the share of the camera paths that reach it.
            kept: depths whose states the forward pass has kept.
            moving: whether rays carry derivatives.
        """

    @abstractmethod
    def backward(self, sweep: Sweep) -> None:
        """Calls `sweep.adjoint` for each bounce of a chunk's paths, the last one first."""
