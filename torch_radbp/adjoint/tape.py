"""Plain autograd as a strategy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from torch import Tensor

from torch_radbp.adjoint.attached import bounce_attached
from torch_radbp.adjoint.images import render_detached, render_images
from torch_radbp.adjoint.strategy import AdjointStrategy
from torch_radbp.adjoint.sweep import Sweep
from torch_radbp.call.render_call import RenderCall
from torch_radbp.tensors.differentiated import with_derivative_of


@dataclass(frozen=True)
class TapeAdjoint(AdjointStrategy):
    """Plain autograd, which records every operation of the forward pass: the reference for tests.

    Memory grows with everything that is computed. The `autograd.Function` of images is not used; the loop over bounces is
    recorded as it runs.
    """

    taped = True

    def image(self, call: RenderCall) -> Tensor:
        """Renders (B, 3, H, W) images with all derivatives."""
        attached = self.dual_image(call.of_derivative())
        return attached if call.shares_samples else with_derivative_of(render_detached(call), attached)

    def dual_image(self, call: RenderCall) -> Tensor:
        """Renders images from the samples of the call, with all derivatives of reverse or forward mode."""
        integrand = call.make_integrand(call.scene)
        return render_images(call, integrand, record=False, bounce=bounce_attached(integrand)).values

    def kept(self, bounces: int, most: int) -> tuple[int, ...]:
        """No depths: autograd keeps what it needs."""
        return ()

    def replayed(self, reaching: Sequence[float], kept: tuple[int, ...], moving: bool) -> float:
        """0 states: nothing is replayed, since autograd has recorded everything."""
        return 0.0

    def backward(self, sweep: Sweep) -> None:
        """Never called: autograd runs the backward pass."""
        raise TypeError("autograd differentiates what it has recorded; there is nothing to sweep")
