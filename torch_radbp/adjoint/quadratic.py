"""The note's first `d_Li`: incident radiance is traced again at every depth."""

from __future__ import annotations

from dataclasses import dataclass

from torch_radbp.adjoint.sweep import Sweep
from torch_radbp.path import PathState, add_at, surviving, survivors, take_step
from torch_radbp.vec import Vec3, masked


@dataclass(frozen=True)
class QuadraticAdjoint:
    """Keeps no radiance and computes L_{k+1} anew for each bounce: N^2 / 2 forward steps. To compare with.

    The states of a path are on the stack of the recursion while it is differentiated, chunk by chunk.

    Args:
        keep_hits: as in `MemoizedAdjoint`.

    Reference: Li 2020, section 1.
    """

    keep_hits: bool = True
    keep_radiance = False

    def kept(self, bounces: int) -> tuple[int, ...]:
        return ()

    def backward(self, sweep: Sweep) -> None:
        """Walks down the path and, as the recursion `d_Li` does, differentiates each bounce on the way back."""
        stack = [sweep.record.start()]
        for depth in range(sweep.record.bounces):
            stack.append(sweep.advance(stack[-1], depth))
        for depth in reversed(range(sweep.record.bounces)):
            sweep.remember(incident_radiance(sweep, stack.pop(), depth + 1))
            sweep.adjoint(stack[-1], depth)


def incident_radiance(sweep: Sweep, state: PathState, depth: int) -> Vec3:
    """L of the paths that have reached `depth`, by lane; 0 where none has."""
    L = Vec3.buffer(sweep.adj_L.x)
    weight = Vec3.full(state.beta.x, 1.0)
    while depth < sweep.record.bounces and len(state.lane):
        vertex, step = take_step(sweep.integrand, state, depth, sweep.record.steps.get(depth))
        add_at(L, state.lane, weight * (vertex.Le + masked(step.visible, vertex.Ld)))
        alive = surviving(vertex)
        weight = Vec3(*(component[alive] for component in weight * vertex.F))
        state, depth = survivors(vertex), depth + 1
    return L
