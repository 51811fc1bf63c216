"""Path replay backpropagation: incident radiance by subtraction and division."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch

from torch_radbp.adjoint.strategy import AdjointStrategy
from torch_radbp.adjoint.sweep import Sweep
from torch_radbp.path.wavefront import bounces
from torch_radbp.plugin import boolean
from torch_radbp.tensors.vec import Vec3, rows


@dataclass(frozen=True)
class ReplayAdjoint(AdjointStrategy):
    """Keeps only L_1 and recovers L_{k+1} = (L_k - E_k) / F_k from bounce to bounce; for comparison.

    Wrong where F_k is 0: at a reflectance of exactly 0 the incident radiance cannot be recovered, and the derivative that
    it would have carried is missing. Use `MemoizedAdjoint` there. It also loses digits where F_k is small. Where rays carry
    derivatives, which come up from below, it keeps every state of a chunk after all.

    Args:
        keep_hits: as in `MemoizedAdjoint`.

    Reference: Vicini et al. 2021, "Path Replay Backpropagation", algorithm 2.
    """

    keep_hits: bool = True

    def __post_init__(self):
        object.__setattr__(self, "keep_hits", boolean("keep_hits", self.keep_hits))

    keep_radiance = True

    def kept(self, bounces: int, most: int) -> tuple[int, ...]:
        """No depths: it keeps no states."""
        return ()

    def replayed(self, reaching: Sequence[float], kept: tuple[int, ...], moving: bool) -> float:
        """The number of states held at once: of all bounces if rays carry derivatives, else of two."""
        return sum(reaching) if moving else 4 * max(reaching)  # of a bounce and the next; its terms are as much again

    def backward(self, sweep: Sweep) -> None:
        """Walks down the path with the remaining radiance L_k, and differentiates each bounce."""
        L, stack = sweep.record.radiance, []
        for bounce in bounces(sweep.integrand, sweep.record.start(), steps=sweep.record.steps):
            depth, state, lane, F = bounce.depth, bounce.state, bounce.vertex.next.lane, bounce.F
            remaining = rows(L, lane) - bounce.E
            incident = Vec3(*(torch.where(f > 0, r / torch.where(f > 0, f, 1.0), 0.0) for r, f in zip(remaining, F)))
            L = Vec3(*(old.index_copy(0, lane.long(), new) for old, new in zip(L, incident)))
            if sweep.moving:
                stack.append((state, L))
            else:
                sweep.remember(L)
                sweep.adjoint(state, depth)
        for depth, (state, L) in reversed(list(enumerate(stack))):
            sweep.remember(L)
            sweep.adjoint(state, depth)
