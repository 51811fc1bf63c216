"""The backward sweep: from the deepest bounce up, with the memo of incident radiance.

    L_k     = E_k + F_k L_{k+1}
    adj_k   = dloss/dL_k = adj_1 beta_k
    dloss/dtheta = sum_k adj_k (dE_k/dtheta + dF_k/dtheta L_{k+1})

When bounce k is reached, L_{k+1} stands in the memo: one vector-Jacobian product of the local map theta -> (E_k, F_k) gives
the parameters' derivatives, and the memo becomes L_k for the bounce above. There is no subtraction of prefixes and no
division by a BSDF value, so that a reflectance of exactly 0 has the right derivative.

Reference: Li 2020, section 2 (`d_Li_cached`, where the memo is called `cache`).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.path import Integrand, PathState, Position, Settings, Step, scattering, survivors, take_step
from torch_radbp.scene.lookup import Tap, lookup, tapped
from torch_radbp.scene.tensors import SceneTensors
from torch_radbp.vec import Vec3, masked

MOST_BLOCKS, MOST_PARTIAL_SUMS = 256, 1 << 16  # of `scatter_add`
FEW_ENTRIES = 8  # of a table whose gradient a compiled bounce sums itself


class PathRecord(NamedTuple):
    """What the forward pass leaves for the backward pass of one chunk of lanes."""

    start: Callable[[], PathState]  # makes the camera paths again
    radiance: Vec3 | None  # L_1 of each lane, kept for path replay only
    states: dict[int, PathState]  # by depth, where the schedule keeps them; depth 0 is `start`
    steps: dict[int, Step]  # by depth, empty with keep_hits=False
    bounces: int


class TableAdjoint(NamedTuple):
    """What one bounce adds to the gradient of a table of K entries."""

    total: Tensor | None  # (K,) float64
    reads: list[tuple[Tensor, Tensor]]  # index and adjoint per lane, still to be scattered


def bounce_adjoint(scene: SceneTensors, wanted: tuple[bool, ...], state: PathState, step: Step, adj_L: Vec3,
                   memo: Vec3, at: Position, settings: Settings) -> tuple[Vec3, list[TableAdjoint]]:
    """The local vector-Jacobian product of one bounce.

    Args:
        scene: detached.
        wanted: of each leaf of `scene` (counted as `tree_flatten` does), whether to differentiate it.
        state, step: the bounce, as in the forward pass.
        adj_L: derivative of the loss with respect to L_1, of all lanes of the chunk.
        memo: L_{k+1} of all lanes of the chunk, 0 where the path ended.
        at, settings: as in the forward pass.

    Returns:
        L_k of the lanes of `state`, and what to add to the gradient of each wanted leaf.
    """
    adj_L, L_next = lookup(adj_L, state.lane) * state.beta, lookup(memo, state.lane)
    taps: list[Tap] = []
    attached, _ = tapped(scene, wanted, 0, taps)
    with torch.enable_grad():
        local = scattering(attached, scene, state, step.hit, at, settings)
        E, F = local.Le + masked(step.visible, local.Ld), local.F
        outputs = [(value, adjoint) for value, adjoint in zip((*E, *F), (*adj_L, *(adj_L * L_next))) if value.requires_grad]
        reads = [leaf for tap in taps for _, leaf in tap.reads]
        adjoints = iter(torch.autograd.grad([value for value, _ in outputs], reads, [adjoint for _, adjoint in outputs],
                                            allow_unused=True) if outputs else ())
    tables = [table_adjoint(tap.table, [(index, next(adjoints)) for index, _ in tap.reads]) for tap in taps]
    return (E + F * L_next).detach(), tables


def table_adjoint(table: Tensor, reads: list[tuple[Tensor, Tensor | None]]) -> TableAdjoint:
    """What the reads of a table add to its gradient; summed at once if that is cheap: compiled, and of few entries."""
    reads = [(index, adjoint) for index, adjoint in reads if adjoint is not None]
    if not (torch.compiler.is_compiling() and len(table) <= FEW_ENTRIES):
        return TableAdjoint(None, reads)
    sums = [sum(((index == entry).to(adjoint.dtype) * adjoint).sum(dtype=torch.float64) for index, adjoint in reads)
            for entry in range(len(table) if reads else 0)]
    return TableAdjoint(torch.stack(sums) if sums else None, [])


class Sweep:
    """The state of one chunk's backward pass: the memo, the adjoint of the image, the gradient buffers."""

    def __init__(self, integrand: Integrand, adjoint_of_bounce: Callable, record: PathRecord, adj_L: Vec3,
                 wanted: tuple[bool, ...], gradients: list[Tensor]):
        self.integrand, self.adjoint_of_bounce, self.record = integrand, adjoint_of_bounce, record
        self.adj_L, self.wanted, self.gradients = adj_L, wanted, gradients
        self.memo = Vec3.buffer(adj_L.x)  # L_{k+1} of each lane; 0 until a deeper bounce has written it

    def advance(self, state: PathState, depth: int) -> PathState:
        """Replays one bounce."""
        vertex, _ = take_step(self.integrand, state, depth, self.record.steps.get(depth))
        return survivors(vertex)

    def adjoint(self, state: PathState, depth: int) -> None:
        """Differentiates one bounce and moves the memo from L_{k+1} to L_k."""
        step = self.record.steps.get(depth)
        if step is None:
            _, step = take_step(self.integrand, state, depth)
        L, tables = self.adjoint_of_bounce(self.integrand.scene, self.wanted, state, step, self.adj_L, self.memo,
                                           self.integrand.at(depth), self.integrand.settings_at(depth))
        places: dict[tuple[int, int], Tensor] = {}
        for gradient, (total, reads) in zip(self.gradients, tables):
            if total is not None:
                gradient += total
            for index, adjoint in reads:
                scatter_add(gradient, index, adjoint, places)
        lane = state.lane.long()
        self.memo = L if len(lane) == len(self.memo.x) else Vec3(*(old.index_copy_(0, lane, new)
                                                                  for old, new in zip(self.memo, L)))


def scatter_add(gradient: Tensor, index: Tensor, adjoint: Tensor, places: dict[tuple[int, int], Tensor]) -> None:
    """Adds each lane's adjoint to its entry of a table's gradient.

    Millions of lanes may add to one entry: one float32 sum would lose what is small against the total (2% of the lamp's
    gradient at 4 million paths). So the total is float64, and small tables are summed in blocks first, in parallel.

    Args:
        gradient: (K,) float64, written into.
        index: (N,) int32.
        adjoint: (N,).
        places: what was made of indices before, for several tables are read at the same ones.
    """
    entries = len(gradient)
    blocks = min(MOST_BLOCKS, len(index), MOST_PARTIAL_SUMS // entries)
    whole = len(index) // blocks * blocks if blocks > 1 else 0
    if whole:
        partial = adjoint.new_zeros(blocks, entries)
        if (id(index), blocks) not in places:
            places[id(index), blocks] = index[:whole].view(blocks, -1).long()
        partial.scatter_add_(1, places[id(index), blocks], adjoint[:whole].view(blocks, -1))
        gradient += partial.sum(0, dtype=gradient.dtype)
    gradient.index_add_(0, index[whole:], adjoint[whole:].to(gradient.dtype))

