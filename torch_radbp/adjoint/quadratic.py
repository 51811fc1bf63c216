"""The note's first `d_Li`: incident radiance is traced anew at every depth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from torch import Tensor

from torch_radbp.adjoint.strategy import AdjointStrategy
from torch_radbp.adjoint.sweep import Sweep
from torch_radbp.path.lanes import add_at
from torch_radbp.path.state import PathState
from torch_radbp.path.wavefront import bounces
from torch_radbp.plugin import boolean
from torch_radbp.tensors.vec import Vec3, rows


@dataclass(frozen=True)
class QuadraticAdjoint(AdjointStrategy):
    """Traces L_{k+1} anew for each bounce, N^2 / 2 forward steps, instead of keeping it; for comparison.

    While a chunk is differentiated, its path states lie on the stack of the recursion.

    Args:
        keep_hits: as in `MemoizedAdjoint`.

    Reference: Li 2020, section 1.
    """

    keep_hits: bool = True

    def __post_init__(self):
        object.__setattr__(self, "keep_hits", boolean("keep_hits", self.keep_hits))

    def kept(self, bounces: int, most: int) -> tuple[int, ...]:
        """No depths: it keeps no states."""
        return ()

    def replayed(self, reaching: Sequence[float], kept: tuple[int, ...], moving: bool) -> float:
        """The number of path states on the recursion's stack, plus the two of the bounces that are traced anew."""
        return sum(reaching) + 2 * max(reaching)  # the stack, and a bounce and the next below it

    def backward(self, sweep: Sweep) -> None:
        """Walks down the path and, as the recursion `d_Li`, differentiates each bounce on the way back."""
        stack = [bounce.state for bounce in bounces(sweep.integrand, sweep.record.start(), steps=sweep.record.steps)]
        for depth, state in reversed(list(enumerate(stack))):
            sweep.remember(radiance_beyond(sweep, state, depth))
            sweep.adjoint(state, depth)


def radiance_beyond(sweep: Sweep, reached: PathState, first: int) -> Vec3:
    """L_{k+1} of the paths that have reached bounce k, at depth `first`, by lane; 0 where they end."""
    L, weight = Vec3.buffer(sweep.adj_L.x), Vec3.full(sweep.adj_L.x, 1.0).map(Tensor.clone)
    for bounce in bounces(sweep.integrand, reached, first, sweep.record.steps):
        if bounce.depth > first:
            lane, ended = bounce.vertex.next.lane, bounce.ended
            here = rows(weight, lane)
            add_at(L, lane, here * bounce.E)
            if bounce.light is not None:
                add_at(L, ended, rows(weight, ended) * bounce.light)
            for old, new in zip(weight, here * bounce.F):
                old.index_copy_(0, lane.long(), new)
    return L
