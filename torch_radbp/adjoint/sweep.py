"""The backward sweep: from the deepest bounce up, with the memo of incident radiance.

    L_k     = E_k + F_k L_{k+1}
    adj_k   = dloss/dL_k = adj_1 beta_k
    dloss/dtheta = sum_k adj_k (dE_k/dtheta + dF_k/dtheta L_{k+1})

When bounce k is reached, L_{k+1} stands in the memo: one vector-Jacobian product of the local map theta -> (E_k, F_k) gives
the parameters' derivatives, and the memo becomes L_k for the bounce above. There is no subtraction of prefixes and no
division by a BSDF value, so that a reflectance of exactly 0 has the right derivative.

If geometry, camera or directions carry derivatives, the local map is (theta, ray_k) -> (E_k, F_k, ray_{k+1}), and beside the
radiance the memo holds dloss/dray_{k+1}, which has come up from below; the same product turns it into dloss/dray_k.

Reference: Li 2020, section 2 (`d_Li_cached`, where the memo is called `cache`).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor
from torch.utils._pytree import tree_flatten, tree_map, tree_map_only, tree_unflatten

from torch_radbp.adjoint.local_map import local_map
from torch_radbp.path import Integrand, PathState, Position, Settings, Step, survivors, take_step
from torch_radbp.raycast.protocol import Hit
from torch_radbp.scene.lookup import Tap, lookup, tapped
from torch_radbp.scene.tensors import SceneTensors
from torch_radbp.vec import Ray, Vec3

MOST_BLOCKS, MOST_PARTIAL_SUMS = 256, 1 << 16  # of `scatter_add`
FEW_ENTRIES = 8  # of a table whose gradient a compiled bounce sums itself


class PathRecord(NamedTuple):
    """What the forward pass leaves for the backward pass of one chunk of lanes."""

    start: Callable[[], PathState]  # makes the camera paths again
    radiance: Vec3 | None  # L_1 of each lane, kept for path replay only
    states: dict[int, PathState]  # by depth, where the schedule keeps them; depth 0 is `start`
    steps: dict[int, Step]  # by depth, empty with keep_hits=False
    bounces: int


class Memo(NamedTuple):
    """What the bounce below has left, (N,) each; zeros where there was none."""

    L: Vec3  # L_{k+1}
    adj_ray: Ray | None = None  # dloss/dray_{k+1}; None if rays do not carry derivatives
    adj_pdf: Tensor | None = None  # the same of the density with which the ray was picked
    hit: Hit | None = None  # what the ray meets; triangle -1: nothing


class TableAdjoint(NamedTuple):
    """What one bounce adds to the gradient of a table of K entries."""

    total: Tensor | None  # (K,) float64
    reads: list[tuple[Tensor, Tensor]]  # index and adjoint per lane, still to be scattered


def bounce_adjoint(scene: SceneTensors, wanted: tuple[bool, ...], state: PathState, step: Step, adj_L: Vec3,
                   memo: Memo, at: Position, settings: Settings) -> tuple[Memo, list[TableAdjoint]]:
    """The local vector-Jacobian product of one bounce.

    Args:
        scene: detached.
        wanted: of each leaf of `scene` (counted as `tree_flatten` does), whether to differentiate it.
        state, step: the bounce, as in the forward pass.
        adj_L: derivative of the loss with respect to L_1, of all lanes of the chunk.
        memo: of all lanes of the chunk.
        at, settings: as in the forward pass.

    Returns:
        The memo for the bounce above, of the lanes of `state`, and what to add to the gradient of each wanted leaf.
    """
    memo = tree_map_only(Tensor, lambda table: lookup(table, state.lane), memo)
    adj_L = lookup(adj_L, state.lane) * state.beta
    taps: list[Tap] = []
    attached, _ = tapped(scene, wanted, 0, taps)
    inputs = ()
    if settings.moving:
        ray, pdf = tree_map(lambda tensor: tensor.clone().requires_grad_(), (state.ray, state.pdf))
        state, inputs = state._replace(ray=ray, pdf=pdf), (*ray.o, *ray.d, pdf)
    with torch.enable_grad():
        local = local_map(attached, scene, state, step, memo.hit, at, settings)
        outputs, adjoints = [*local.E, *local.F], [*adj_L, *(adj_L * memo.L)]
        if local.ray is not None:
            outputs += [*local.ray.o, *local.ray.d, local.pdf]
            adjoints += [*memo.adj_ray.o, *memo.adj_ray.d, memo.adj_pdf]
        reads = [leaf for tap in taps for _, leaf in tap.reads]
        adjoints = iter(vector_jacobian_product(outputs, [*inputs, *reads], adjoints))
    above = Memo((local.E + local.F * memo.L).detach())
    if settings.moving:
        ox, oy, oz, dx, dy, dz, adj_pdf = (zeros_unless(next(adjoints), leaf) for leaf in inputs)
        above = Memo(above.L, Ray(Vec3(ox, oy, oz), Vec3(dx, dy, dz)), adj_pdf, step.hit)
    return above, [table_adjoint(tap.table, [(index, next(adjoints)) for index, _ in tap.reads]) for tap in taps]


def vector_jacobian_product(outputs: list[Tensor], inputs: list[Tensor], adjoints: list[Tensor]) -> tuple:
    """The adjoints of `inputs`; None where nothing depends on them."""
    dependent = [(output, adjoint) for output, adjoint in zip(outputs, adjoints) if output.requires_grad]
    if not dependent or not inputs:
        return (None,) * len(inputs)
    outputs, adjoints = zip(*dependent)
    return torch.autograd.grad(outputs, inputs, adjoints, allow_unused=True)


def zeros_unless(adjoint: Tensor | None, like: Tensor) -> Tensor:
    """The adjoint, or zeros where there is none."""
    return torch.zeros_like(like) if adjoint is None else adjoint


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
        self.memo = empty_memo(adj_L.x, self.moving)

    def advance(self, state: PathState, depth: int) -> PathState:
        """Replays one bounce."""
        vertex, _ = take_step(self.integrand, state, depth, self.record.steps.get(depth))
        return survivors(vertex)

    @property
    def moving(self) -> bool:
        """Whether rays carry derivatives, so that bounces must be differentiated from the deepest up."""
        return self.integrand.settings.moving

    def remember(self, L: Vec3) -> None:
        """Puts incident radiance into the memo."""
        self.memo = self.memo._replace(L=L.map(torch.clone))

    def adjoint(self, state: PathState, depth: int) -> None:
        """Differentiates one bounce and moves the memo from L_{k+1} to L_k."""
        step = self.record.steps.get(depth)
        if step is None:
            _, step = take_step(self.integrand, state, depth)
        above, tables = self.adjoint_of_bounce(self.integrand.scene, self.wanted, state, step, self.adj_L, self.memo,
                                               self.integrand.at(depth), self.integrand.settings_at(depth))
        places: dict[tuple[int, int], Tensor] = {}
        for gradient, (total, reads) in zip(self.gradients, tables):
            if total is not None:
                gradient += total
            for index, adjoint in reads:
                scatter_add(gradient, index, adjoint, places)
        self.memo = replaced(self.memo, state.lane, above)


def empty_memo(like: Tensor, moving: bool) -> Memo:
    """What stands in the memo before the deepest bounce of each lane."""
    if not moving:
        return Memo(Vec3.buffer(like))
    miss = Hit(torch.full_like(like, -1, dtype=torch.int32), *(torch.zeros_like(like) for _ in range(3)))
    return Memo(Vec3.buffer(like), Ray(Vec3.buffer(like), Vec3.buffer(like)), torch.zeros_like(like), miss)


def replaced(memo: Memo, lane: Tensor, above: Memo) -> Memo:
    """The memo with new rows in the places `lane`."""
    if len(lane) == len(memo.L.x):
        return above
    place = lane.long()
    pairs = zip(tree_flatten(memo)[0], tree_flatten(above)[0])
    rows = [old if old is None else old.index_copy_(0, place, new) for old, new in pairs]
    return tree_unflatten(rows, tree_flatten(memo)[1])


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
    blocks = max(1, min(MOST_BLOCKS, len(index), MOST_PARTIAL_SUMS // entries))
    whole = len(index) // blocks * blocks
    if (id(index), blocks) not in places:
        places[id(index), blocks] = index[:whole].view(blocks, -1).long()
    place = places[id(index), blocks]
    if blocks == 1:
        gradient.scatter_add_(0, place[0], adjoint.to(gradient.dtype))
        return
    partial = adjoint.new_zeros(blocks, entries)
    partial.scatter_add_(1, place, adjoint[:whole].view(blocks, -1))
    gradient += partial.sum(0, dtype=gradient.dtype)
    gradient.index_add_(0, index[whole:], adjoint[whole:].to(gradient.dtype))
